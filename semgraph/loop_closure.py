"""Finds older landmarks that are in sight again: a loop closes where they turn out to be the same."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.association import associate
from semgraph.factor_graph import FactorGraph
from semgraph.landmarks import Kind
from semgraph.measurement_model import CHI2_2DOF_999

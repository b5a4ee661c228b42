"""A bounded choice of what came, spread evenly over all of it."""

from typing import Generic, TypeVar, final

import numpy as np

from semgraph.errors import InputError

Item = TypeVar("Item")


@final
class Thinned(Generic[Item]):
    """Keeps every item until there are more than `capacity`, then every second, fourth, ...

    Raises:
        InputError: a capacity below 1.
    """

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise InputError(f"thinned: expected room for at least one, got {capacity}")
        self._capacity = capacity
        self._kept: list[Item] = []
        self._stride = 1
        self._count = 0

    def add(self, item: Item) -> None:
        """The next item; it is kept or not."""
        if self.takes_next():
            self._kept.append(item)
        self._count += 1
        if len(self._kept) > self._capacity:
            self._kept = self._kept[::2]
            self._stride *= 2

    def takes_next(self) -> bool:
        """Whether the next item will be kept, for now."""
        return self._count % self._stride == 0

    @property
    def kept(self) -> tuple[Item, ...]:
        """In the order in which they came: at most `capacity`, and at least half of it."""
        return tuple(self._kept)

    @property
    def count(self) -> int:
        """How many came."""
        return self._count

    @property
    def stride(self) -> int:
        """Of so many, one is kept."""
        return self._stride

    def spread(self, count: int) -> tuple[Item, ...]:
        """At most `count` of the kept, first and last among them."""
        rows = np.unique(np.linspace(0, len(self._kept) - 1, count).round().astype(int))
        return tuple(self._kept[row] for row in rows if self._kept)

"""Names and numbers beside a chart: all to be read, and none like another."""

import re

from evaluation.study_report.chart import Chart, rows_chart
from evaluation.study_report.scales import Scale


def test_conditions_that_differ_in_a_grid_have_names_of_their_own() -> None:
    names = [f"short, missed={m}, search_radius_m={r}" for m in (0.1, 0.4) for r in (0.8, 1.6)]
    rows = rows_chart(names, Scale(0.0, 1.0)).rows
    assert rows[1] == ("missed=0.1,", "search_radius_m=1.6")
    assert len(set(rows)) == 4


def test_a_name_of_one_long_word_keeps_its_end() -> None:
    assert rows_chart(["x" * 50 + "-end"], Scale(0.0, 1.0)).rows == (("…" + "x" * 21 + "-end",),)


def test_the_label_at_the_left_is_beside_the_numbers_not_over_them() -> None:
    chart = Chart(Scale(0.0, 1.0, "time (s)"), Scale(0.01121, 0.01362, "path error (m)"))
    ends = re.findall(r'text-anchor="end" x="([\d.]+)"[^>]*>([^<]+)<', chart.svg("t", "d"))
    assert ends
    assert all(float(x) - 7.0 * len(word) > 20.0 for x, word in ends)

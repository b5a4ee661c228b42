"""Charts as inline SVG that takes its colours from the page, so that it follows light and dark."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from evaluation.study_report.markup import Markup, element, joined
from evaluation.study_report.scales import Scale, tick_text
from semgraph.arrays import BoolArray, FloatArray

WIDTH: Final = 460
_MOST_LETTERS: Final = 26
_LINE: Final = 13.0
_TOP, _RIGHT, _BOTTOM = 10.0, 14.0, 44.0


@dataclass(slots=True)
class Chart:
    """Axes to draw on, in pixels of its own that the page stretches.

    Attributes:
        left: room for the labels at the left; 0 for as much as they need.
        rows: names of one or two lines instead of a scale at the left, from the top.
    """

    x: Scale
    y: Scale
    height: float = 300.0
    left: float = 0.0
    rows: Sequence[tuple[str, ...]] = ()
    drawn: list[Markup] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.left = self.left or _room_left(self.y)

    def place_x(self, values: FloatArray | float) -> FloatArray:
        """Pixels from the left."""
        return self.left + self.x.share(values) * (WIDTH - self.left - _RIGHT)

    def place_y(self, values: FloatArray | float) -> FloatArray:
        """Pixels from the top."""
        return _TOP + (1.0 - self.y.share(values)) * (self.height - _TOP - _BOTTOM)

    def line(self, xs: FloatArray, ys: FloatArray, class_: str) -> None:
        """A line through points; it breaks at NaN."""
        self.drawn.append(element("path", class_=f"line {class_}", d=self._path(xs, ys)))

    def band(self, xs: FloatArray, lows: FloatArray, highs: FloatArray, class_: str) -> None:
        """An area between two lines, where both are known."""
        known = np.isfinite(lows) & np.isfinite(highs)
        if known.any():
            around = np.concatenate([xs[known], xs[known][::-1]])
            edge = np.concatenate([lows[known], highs[known][::-1]])
            path = self._path(around, edge) + "Z"
            self.drawn.append(element("path", class_=f"band {class_}", d=path))

    def dots(self, xs: FloatArray, ys: FloatArray, class_: str, radius: float = 2.5) -> None:
        """A dot at each point, all in one path."""
        known = np.isfinite(xs) & np.isfinite(ys)
        places = zip(self.place_x(xs[known]), self.place_y(ys[known]), strict=True)
        # A line of no length with round caps is a disc; a path of many is far shorter than circles.
        path = "".join(f"M{px:.1f} {py:.1f}h0" for px, py in places)
        width = 2.0 * radius
        self.drawn.append(element("path", class_=f"dots {class_}", d=path, stroke_width=width))

    def ring(self, xs: FloatArray, ys: FloatArray, class_: str, radius: float) -> None:
        """A circle around each point."""
        places = zip(self.place_x(xs), self.place_y(ys), strict=True)
        path = "".join(
            f"M{px - radius:.1f} {py:.1f}a{radius} {radius} 0 1 0 {2 * radius} 0"
            f"a{radius} {radius} 0 1 0 {-2 * radius} 0"
            for px, py in places
        )
        self.drawn.append(element("path", class_=f"ring {class_}", d=path))

    def box(self, low: float, high: float, row: float, class_: str, half: float = 0.28) -> None:
        """A bar along x about a row."""
        left, right = self.place_x(low), self.place_x(high)
        top, bottom = self.place_y(row + half), self.place_y(row - half)
        self.drawn.append(
            element(
                "rect",
                class_=class_,
                x=f"{left:.1f}",
                y=f"{top:.1f}",
                width=f"{max(float(right - left), 0.5):.1f}",
                height=f"{float(bottom - top):.1f}",
            )
        )

    def upright(self, x: float, class_: str) -> None:
        """A line over the whole height."""
        if self.x.low <= x <= self.x.high:
            self.line(np.array([x, x]), np.array([self.y.low, self.y.high]), class_)

    def labels(self, named: Sequence[tuple[float, float, str]]) -> None:
        """A name beside each point (x, y), where it covers neither another name nor a point."""
        points = [(float(self.place_x(x)), float(self.place_y(y))) for x, y, _ in named]
        taken = [(px - 5.0, py - 5.0, px + 5.0, py + 5.0) for px, py in points]
        for (px, py), (_, _, name) in zip(points, named, strict=True):
            place = _free_place(px, py, 7.3 * len(name), taken)
            taken.append(place)
            if abs(place[1] + 6.0 - py) > 12.0:
                near = f"M{px:.1f} {py:.1f}L{place[0]:.1f} {place[1] + 6.0:.1f}"
                self.drawn.append(element("path", class_="line leader", d=near))
            self.drawn.append(_word(place[0], place[1] + 10.0, name, "start", None))

    def svg(self, title: str, description: str) -> Markup:
        """The chart; `description` says in words what is to be seen."""
        return element(
            "svg",
            element("title", title),
            element("desc", description),
            self._axes(),
            *self.drawn,
            viewBox=f"0 0 {WIDTH} {self.height:g}",
            role="img",
            aria_label=f"{title}. {description}",
        )

    def _path(self, xs: FloatArray, ys: FloatArray) -> str:
        known = np.isfinite(xs) & np.isfinite(ys)
        pxs, pys = self.place_x(np.where(known, xs, 0.0)), self.place_y(np.where(known, ys, 0.0))
        steps = np.where(_begins(known), "M", "L")
        return "".join(
            f"{step}{px:.1f} {py:.1f}"
            for step, px, py in zip(steps[known], pxs[known], pys[known], strict=True)
        )

    def _axes(self) -> Markup:
        grid, words, bottom = "", [], self.height - _BOTTOM
        for tick in self.x.ticks:
            px = float(self.place_x(tick))
            grid += f"M{px:.1f} {_TOP}V{bottom:.1f}"
            words.append(_word(px, bottom + 16.0, tick_text(tick), "middle"))
        for place, name in self._names():
            grid += f"M{self.left:g} {place:.1f}H{WIDTH - _RIGHT:g}"
            first = place + 4.0 - 0.5 * _LINE * (len(name) - 1)
            for number, line in enumerate(name):
                words.append(_word(self.left - 7.0, first + _LINE * number, line, "end"))
        middle = 0.5 * (self.left + WIDTH - _RIGHT)
        words.append(_word(middle, self.height - 8.0, self.x.label, "middle", "label"))
        if self.y.label:
            turned = f"translate(13 {0.5 * (_TOP + bottom):.0f}) rotate(-90)"
            label = element(
                "text", self.y.label, class_="label", text_anchor="middle", transform=turned
            )
            words.append(label)
        return joined([element("path", class_="grid", d=grid), *words])

    def _names(self) -> list[tuple[float, tuple[str, ...]]]:
        if self.rows:
            last = len(self.rows) - 1
            return [(float(self.place_y(last - row)), name) for row, name in enumerate(self.rows)]
        return [(float(self.place_y(tick)), (tick_text(tick),)) for tick in self.y.ticks]


def rows_chart(names: Sequence[str], x: Scale, row_height: float = 27.0) -> Chart:
    """A chart with a row for each name; the first, at the top, is row len(names) - 1."""
    height = _TOP + _BOTTOM + row_height * len(names)
    shown = tuple(_lines(name) for name in _without_what_all_begin_with(names))
    left = 16.0 + 7.6 * max((len(line) for name in shown for line in name), default=0)
    return Chart(x, Scale(-0.5, len(names) - 0.5), height, left, rows=shown)


def map_chart(points: FloatArray) -> Chart:
    """A chart of a plane in metres, as long as it is wide on both axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.04 * float((high - low).max()) or max(1.0, 0.04 * float(np.abs(points).max()))
    low, high = low - room, high + room
    left = _room_left(Scale(float(low[1]), float(high[1])))
    width_m, height_m = high - low
    height = (WIDTH - left - _RIGHT) * height_m / width_m
    if height > 460.0:
        more = 0.5 * ((WIDTH - left - _RIGHT) * height_m / 460.0 - width_m)
        sideways = np.array([more, 0.0])
        low, high, height = low - sideways, high + sideways, 460.0
    return Chart(
        Scale(float(low[0]), float(high[0]), "x (m)"),
        Scale(float(low[1]), float(high[1]), "y (m)"),
        float(height) + _TOP + _BOTTOM,
        left,
    )


def _room_left(y: Scale) -> float:
    """Pixels for the ticks' words and the turned label beside them."""
    return max(56.0, 28.0 + 7.4 * max((len(tick_text(tick)) for tick in y.ticks), default=0))


def _without_what_all_begin_with(names: Sequence[str]) -> list[str]:
    """Names of conditions, without the part before a comma that says nothing between them."""
    firsts = {name.partition(", ")[0] for name in names}
    rests = [name.partition(", ")[2] for name in names]
    return rests if len(firsts) == 1 and len(names) > 1 and all(rests) else list(names)


def _lines(name: str) -> tuple[str, ...]:
    """One line, or two of what is too long; of what is longer yet their ends."""
    words = name.split(" ")
    if len(name) <= _MOST_LETTERS or len(words) == 1:
        return (_shortened(name),)
    both = [(" ".join(words[:k]), " ".join(words[k:])) for k in range(1, len(words))]
    return tuple(map(_shortened, min(both, key=lambda lines: max(map(len, lines)))))


def _shortened(name: str) -> str:
    """The last letters of what is too long: conditions differ there."""
    return name if len(name) <= _MOST_LETTERS else f"…{name[1 - _MOST_LETTERS :]}"


def _begins(known: BoolArray) -> BoolArray:
    """Where a stretch of known points begins."""
    begins: BoolArray = known.copy()
    begins[1:] &= ~known[:-1]
    return begins


def _word(px: float, py: float, words: str, anchor: str, class_: str | None = None) -> Markup:
    at = {"x": f"{px:.1f}", "y": f"{py:.1f}"}
    return element("text", words, text_anchor=anchor, class_=class_, **at)


def _free_place(
    px: float, py: float, width: float, taken: Sequence[tuple[float, float, float, float]]
) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a word near a point; the least covered of some places."""
    ups = (-6.0, -16.0, 4.0, -28.0, 16.0, -40.0, 28.0, -52.0, 40.0)
    places = [
        (left, py + up, left + width, py + up + 12.0)
        for up in ups
        for left in (px + 8.0, px - 8.0 - width)
        if left > 0.0 and left + width < WIDTH and py + up > 0.0
    ] or [(px, py, px + width, py + 12.0)]
    return min(places, key=lambda place: sum(_overlap(place, each) for each in taken))


def _overlap(
    one: tuple[float, float, float, float], other: tuple[float, float, float, float]
) -> float:
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(width, 0.0) * max(height, 0.0)

"""Series of points on logarithmic axes, as most sections of the page draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.plots import Axis, Key, Plot

# Style and marker of a series, in order.
LOOKS = tuple(
    (f"c{place % 6}", marker)
    for marker in ("circle", "square", "diamond")
    for place in (5, 1, 4, 2, 0, 3)
)
Point = tuple[float, float, str]  # x, y, and what is told of it


def chart(
    title: str,
    x: tuple[str, str],
    y: tuple[str, str],
    series: Mapping[str, Sequence[Point]],
    *,
    lines: bool = False,
    height: int = 400,
) -> Plot | None:
    """x, y: quantity and unit.

    series: its words -> its points, joined in their order where `lines` asks for it. None without a
    point.
    """
    points = [point for some in series.values() for point in some]
    if not points:
        return None
    plot = Plot(
        title,
        Axis.fitted(*x, [point[0] for point in points], log=True, margin=0.06),
        Axis.fitted(*y, [point[1] for point in points], log=True, margin=0.06),
        width=720,
        height=height,
    )
    for (words, some), (style, marker) in zip(series.items(), LOOKS, strict=False):
        plot.keys.append(Key(style, words, marker))
        if lines:
            plot.line(words, style, [point[0] for point in some], [point[1] for point in some])
        for across, up, tip in some:
            plot.point(across, up, style, marker, tip)
    return plot

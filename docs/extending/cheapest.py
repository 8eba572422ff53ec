"""The cheapest plan that holds, for each scene."""

from __future__ import annotations

from reports.pages.section import Report, Section


def build(report: Report) -> Section | None:
    """Return the section, or None if no plan holds."""
    cheapest = []
    for scene in report.scenes:
        holding = [
            row
            for row in report.rows_of_scene(scene)
            if row.stage.verdict == "holds" and row.stage.cost is not None
        ]
        if holding:
            cheapest.append((scene.name, min(holding, key=lambda row: row.stage.cost)))
    if not cheapest:
        return None
    title = "The cheapest plan that holds"
    sentence = f"{title}, for {len(cheapest)} scenes."
    return Section("cheapest", title, "cheapest.html", {"cheapest": cheapest}, said=sentence)

"""ONE FILE = ONE SECTION of the page: `build(report) -> Section | None`, with a template of the same name."""

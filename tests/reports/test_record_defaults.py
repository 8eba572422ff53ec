"""What a record does not say is nothing: every default of the schemas is empty, but for those that are named here."""

from collections.abc import Iterator
from importlib import import_module

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

MODULES = ("record", "check_record")
# Not empty: what is meant where nothing is said.
MEANT = {
    "RunRecord.schema_version": 5, "CampaignRecord.schema_version": 5, "CheckRecord.schema_version": 5,
    "RunRecord.part": 1, "RunRecord.parts": 1, "RunRecord.verdict": "no plan", "StageRecord.verdict": "no plan",
    "ReplayRecord.step_source": "none", "ReplayRecord.judged": "open", "ContactRecord.bodies": ("", ""), "SeriesRecord.line": True,
}  # fmt: skip


def defaults() -> Iterator[tuple[str, object]]:
    for name in MODULES:
        module = import_module(f"reports.records.{name}")
        for model in vars(module).values():
            if isinstance(model, type) and issubclass(model, BaseModel) and model.__module__ == module.__name__:
                for field, info in model.model_fields.items():
                    default = info.get_default(call_default_factory=True)
                    if default is not PydanticUndefined:
                        yield f"{model.__name__}.{field}", default


ALL = dict(defaults())


@pytest.mark.parametrize("name", ALL)
def test_what_is_not_said_is_nothing(name: str):
    default = ALL[name]
    if name in MEANT:
        assert default == MEANT[name]
    elif isinstance(default, BaseModel):
        assert not any(default.model_dump().values())
    else:
        assert not default, "an empty text, list, None, no or nought"


def test_all_that_is_meant_exists():
    assert len(ALL) > 100
    assert set(MEANT) <= set(ALL)

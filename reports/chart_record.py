"""ChartRecord: the data of one plot that an examination draws itself - curves on two axes, and how to read them."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class AxisRecord(_Model):
    quantity: str
    unit: str = ""
    log: bool = False


class SeriesRecord(_Model):
    """x, y: of equal length; line: joined, else points alone."""

    name: str
    x: tuple[Finite, ...]
    y: tuple[Finite, ...]
    line: bool = True


class ChartRecord(_Model):
    """level: a horizontal line, with its words; words: what the plot shows, as a sentence."""

    title: str
    x: AxisRecord
    y: AxisRecord
    series: tuple[SeriesRecord, ...]
    level: Finite | None = None
    level_words: str = ""
    words: str = ""

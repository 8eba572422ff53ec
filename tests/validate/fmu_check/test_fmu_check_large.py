"""A large FMU is no alarm: what costs an instance a variable is asked of some of them, and the sentence says of how many."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from edited_fmu import edited
from shell_fmu import FOREIGN, PARAMETER, build_shell

from validate.fmi.instance import CLASSES
from validate.fmu_check import Status, check_fmu
from validate.fmu_check.subject import Block, Subject

COUNT = 20_000  # 40 million values in all, one instance a value


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [False, True])
def test_start_values_of_many_parameters_are_drawn(tmp_path: Path, wrong: bool):
    ball = FOREIGN[0]
    more = tuple(
        (f"pipe[{number}].k", PARAMETER, f'start="{int(wrong and number == 9000)}"')
        for number in range(COUNT)
    )
    model = replace(
        ball,
        macros=ball.macros.replace("#define NR 7", f"#define NR {7 + COUNT}"),
        reals=ball.reals + more,
    )
    report = check_fmu(
        build_shell(model, tmp_path),
        names=["start values are the XML's", "start values are obeyed"],
        seconds=600.0,
    )
    (stored, obeyed) = (
        row for row in report.rows if row.type == "ME" and row.name.startswith("start values")
    )
    assert obeyed.status is Status.PASSED, obeyed.sentence
    assert f"1999 of {COUNT + 5} start values" in obeyed.sentence
    assert stored.status is (Status.FAILED if wrong else Status.PASSED)
    assert ("pipe[9000].k is 0 in the binary, 1" in stored.sentence) is wrong


@pytest.mark.slow
def test_dependencies_are_looked_at_without_comparing_each_parameter_with_each(tmp_path: Path):
    """60 of 100,000 parameters are moved.

    Ten thousand million comparisons of names would end at the limit.
    """
    ball, many = FOREIGN[0], 100_000
    more = tuple((f"p{number}", PARAMETER, 'start="0"') for number in range(many))
    model = replace(
        ball,
        macros=ball.macros.replace("#define NR 7", f"#define NR {7 + many}"),
        reals=ball.reals + more,
    )
    unknown = '<InitialUnknowns><Unknown index="3"'
    path = edited(
        build_shell(model, tmp_path),
        tmp_path / "edited.fmu",
        lambda text: text.replace(unknown, f'{unknown} dependencies="4"'),
    )
    report = check_fmu(path, names=["dependencies are complete"], seconds=120.0)
    told = [(row.type, row.status) for row in report.rows if row.name.startswith("dependencies")]
    assert told == [("ME", Status.PASSED), ("CS", Status.PASSED)], report.rows


def variables(*kinds: tuple[str, str | None, tuple[int, ...]]) -> Block:
    """Variables of a type, a start and a shape, with references 10, 11, .."""
    made = [
        SimpleNamespace(
            name=f"v{place}", type=kind, start=start, shape=shape, valueReference=10 + place,
            causality="parameter", variability="tunable",
            initial="exact", clocks=None, min=None, max="2" if place == 0 else None,
            nominal="8" if place == 2 else None, unit=None, declaredType=None,
        )
        for place, (kind, start, shape) in enumerate(kinds)
    ]  # fmt: skip
    return Block(Subject(Path(), SimpleNamespace(modelVariables=made)).variables)


MIXED = (
    ("Float64", "2", ()),
    ("Int32", "7", ()),
    ("Float64", "0", (3,)),
    ("Boolean", "true", ()),
    ("Int32", None, (2,)),
)


def test_variables_of_several_types_and_shapes_are_one_call_a_type_and_keep_their_order():
    block = variables(*MIXED)
    memory: dict[str, Any] = {}
    for references, places in block.parts(CLASSES[3, "ME"]):
        memory[references.kind] = (
            list(references.array),
            references.size,
            np.arange(block.entries)[places].tolist(),
        )
    assert memory == {
        "Float64": ([10, 12], 4, [0, 2, 3, 4]),
        "Int32": ([11, 14], 3, [1, 6, 7]),
        "Boolean": ([13], 1, [5]),
    }
    assert block.parts(CLASSES[3, "ME"]) is block.parts(CLASSES[3, "CS"]), "found out once"
    assert block.names == ["v0", "v1", "v2", "v2", "v2", "v3", "v4", "v4"]
    assert block.ends.tolist() == [0, 1, 2, 5, 6, 8]
    ((one, everything),) = variables(("Float32", "1", ())).parts(CLASSES[3, "ME"])
    assert (one.values.dtype, everything) == (np.float32, slice(None))
    assert (Block().parts(CLASSES[2, "CS"]), Block().entries, Block().starts.size) == ([], 0, 0)


def test_starts_are_moved_to_the_side_that_the_range_allows():
    """2 of at most 2 goes down; 0 goes by a share of its nominal 8, in all three entries.

    What has no start goes nowhere.
    """
    block = variables(*MIXED)
    assert block.near(0.25).tolist()[:6] == [1.5, 8.75, 2.0, 2.0, 2.0, 1.25]
    assert np.isnan(block.near(0.25)[6:]).all()
    assert block.starts.tolist()[:6] == [2.0, 7.0, 0.0, 0.0, 0.0, 1.0]

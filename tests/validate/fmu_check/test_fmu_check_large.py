"""A large FMU is no alarm: what costs an instance a variable is asked of some of them, and the sentence says of how many."""

from dataclasses import replace
from pathlib import Path

import pytest
from shell_fmu import FOREIGN, PARAMETER, build_shell

from validate.fmu_check import Status, check_fmu

COUNT = 20_000  # 40 million values in all, one instance a value


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [False, True])
def test_start_values_of_many_parameters_are_drawn(tmp_path: Path, wrong: bool):
    ball = FOREIGN[0]
    more = tuple((f"pipe[{number}].k", PARAMETER, f'start="{int(wrong and number == 9000)}"') for number in range(COUNT))
    model = replace(ball, macros=ball.macros.replace("#define NR 7", f"#define NR {7 + COUNT}"), reals=ball.reals + more)
    report = check_fmu(build_shell(model, tmp_path), names=["start values are the XML's", "start values are obeyed"], seconds=600.0)
    (stored, obeyed) = (row for row in report.rows if row.type == "ME" and row.name.startswith("start values"))
    assert obeyed.status is Status.PASSED, obeyed.sentence
    assert "1999 start values" in obeyed.sentence
    assert f"drawn from {COUNT + 5}" in obeyed.sentence
    assert stored.status is (Status.FAILED if wrong else Status.PASSED)
    assert ("pipe[9000].k is 0 in the binary, 1" in stored.sentence) is wrong

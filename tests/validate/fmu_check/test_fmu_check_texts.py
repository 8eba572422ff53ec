"""Variables without numbers and terminals: strings are read and are their starts, terminals name what there is."""

import zipfile
from pathlib import Path

import pytest
from edited_fmu import edited
from shell_fmu import FOREIGN, build_shell

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.fmu_check import Status, check_fmu

STRING = '<ScalarVariable name="who" valueReference="0" causality="parameter" variability="fixed" initial="exact"><String start="{}"/></ScalarVariable>'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "start", "said"),
    [
        (None, "", "who is refused, or no text; it said: "),
        ('"me"', "me", "1 of them strings"),
        ('"me"', "you", "who is 'me' in the binary, 'you' in the description"),
        ("NULL", "me", "no text"),
        ('"\\xff"', "me", "no text"),
    ],
)
def test_a_string_is_read_and_is_its_start(
    tmp_path: Path, given: str | None, start: str, said: str
):
    refusal = 'SELF; return n ? refuse(self, "no strings") : fmi2OK;'
    giving = (
        refusal
        if given is None
        else f"(void)c; for (size_t k = 0; k < n; k++) value[k] = {given}; return fmi2OK;"
    )
    fmu = build_shell(FOREIGN[0], tmp_path, (refusal, giving))
    target = edited(
        fmu,
        tmp_path / "texts.fmu",
        lambda text: text.replace("</ModelVariables>", f"{STRING.format(start)}</ModelVariables>"),
    )
    report = check_fmu(target, names=["variables can be read"], seconds=300.0)
    (row,) = (
        row for row in report.rows if row.name == "variables can be read" and row.type == "ME"
    )
    assert row.status is (Status.PASSED if start == "me" and given == '"me"' else Status.FAILED)
    assert said in row.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('variableName="lam_left"', 'variableName="lam_lefd"', "'lam_lefd', which there is not"),
        ("</fmiTerminalsAndIcons>", "", "no XML"),
    ],
)
def test_terminals_name_what_there_is(tmp_path: Path, old: str, new: str, said: str):
    path, target = "terminalsAndIcons/terminalsAndIcons.xml", tmp_path / "terminals.fmu"
    with (
        zipfile.ZipFile(build_fmu(load_scene("three_cart"))) as archive,
        zipfile.ZipFile(target, "w") as made,
    ):
        assert old.encode() in archive.read(path)
        for name in archive.namelist():
            made.writestr(
                name,
                archive.read(name).replace(old.encode(), new.encode())
                if name == path
                else archive.read(name),
            )
    (row,) = (
        row
        for row in check_fmu(target, names=["description is valid"]).rows
        if row.name == "description is valid"
    )
    assert row.status is Status.FAILED
    assert path in row.sentence
    assert said in row.sentence

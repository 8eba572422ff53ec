"""One value of an FMU is one variable, whatever it is called: aliases of FMI 3.0, and variables of FMI 2.0 that share a value reference."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from edited_fmu import edited
from foreign_fmu import FULL_MAP, build_foreign, foreign_plan, write_plan

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.fmu import build_fmu
from validate.fmu_check import Status, check_fmu
from validate.judge.judgement import WiredFmu, wire_fmu
from validate.judge.robustness.worlds import perturbations

_START = '[start]\n"body.pos" = "x"\n"body.vel" = "v_x"\n'
BARE = FULL_MAP.partition("[contacts.stop]")[0] + _START
# Of FMI 2.0: the mass by another name, with a range of its own, and the position as an output.
_MORE = """    <ScalarVariable name="m" valueReference="40" causality="parameter" variability="fixed" initial="exact"><Real unit="kg" start="2" max="3"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="10" causality="output" variability="continuous" initial="calculated"><Real unit="mm"/></ScalarVariable>
    <ScalarVariable name="f" valueReference="20" causality="local" variability="continuous"><Real unit="kN"/></ScalarVariable>
  </ModelVariables>"""


def _in_fmi2(folder: Path) -> Path:
    return edited(
        build_foreign(folder / "cart.fmu"),
        folder / "alias.fmu",
        lambda text: text.replace("  </ModelVariables>", _MORE),
    )


def _in_fmi3(source: Path, target: Path) -> Path:
    """The stiffness of a spring by two more names."""
    names = '<Alias name="spring.k"/><Alias name="spring.rate"/></Float64>'

    def change(text: str) -> str:
        before, start, after = text.partition('<Float64 name="k"')
        element, _, rest = after.partition("/>")
        return f"{before}{start}{element}>{names}{rest}"

    return edited(source, target, change)


@pytest.fixture
def wired(tmp_path: Path) -> Callable[..., WiredFmu]:
    plan = write_plan(tmp_path / "plan.csv", "t,x,v_x,F", foreign_plan()[:9])

    def wire(text: str) -> WiredFmu:
        (tmp_path / "map.toml").write_text(text, encoding="utf-8")
        return wire_fmu(_in_fmi2(tmp_path), plan, map_path=tmp_path / "map.toml")

    return wire


def test_parameter_of_two_names_is_drawn_once(wired: Callable[..., WiredFmu]):
    """By the name that the map has for it, within both ranges."""
    foreign = wired(f"{BARE}[uncertainty]\nm = 0.25\n").foreign
    (mass,) = foreign.model.parameters
    assert (mass.name, mass.aliases, mass.uncertainty) == ("m", ("body.mass",), 0.25)
    assert (mass.lower, mass.upper, mass.value) == (0.0, 3.0, 2.0)
    assert foreign.parameters == (40,)


def test_value_of_one_name_is_that_of_the_other(wired: Callable[..., WiredFmu]):
    (mass,) = wired(f"{BARE}[parameters]\nm = 2.5\n").foreign.model.parameters
    assert (mass.name, mass.value) == ("m", 2.5)
    (mass,) = wired(BARE).foreign.model.parameters
    assert (mass.name, mass.aliases) == ("body.mass", ("m",))


@pytest.mark.parametrize("name", ["m", "body.mass"])
def test_perturbation_by_any_name(name: str, wired: Callable[..., WiredFmu]):
    given = wired(BARE)
    (cause,) = perturbations(given.foreign.model, given.plan, [name])
    assert cause.name == "body.mass"


@pytest.mark.parametrize("section", ["parameters", "uncertainty"])
def test_two_names_of_one_value_are_refused(section: str, wired: Callable[..., WiredFmu]):
    with pytest.raises(TouchstoneError, match=f"'body.mass' is {section}.m already") as caught:
        wired(f'{BARE}[{section}]\nm = 1.0\n"body.mass" = 1.5\n')
    assert "map.toml" in str(caught.value)


def test_start_and_input_by_a_name_that_is_calculated(wired: Callable[..., WiredFmu]):
    """`y` is the position, whose start can be set, and `f` the input."""
    own = wired(BARE).foreign
    other = wired(BARE.replace("body.pos", "y").replace("drive.force", "f")).foreign
    assert other.start.tolist() == own.start.tolist()
    assert other.variables == own.variables
    assert other.model.startable == own.model.startable
    assert other.model.inputs == own.model.inputs


def test_aliases_of_fmi3_are_one_parameter(tmp_path: Path):
    path = _in_fmi3(build_fmu(load_scene("three_cart"), "3.0"), tmp_path / "alias.fmu")
    names = ("t", "q1", "q2", "q3", "u1", "u3")
    rows = [",".join(names), *(f"{t},2,3,4,0,0" for t in (0.0, 0.1, 0.2))]
    (tmp_path / "plan.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    wired = wire_fmu(path, tmp_path / "plan.csv")
    springs = [item for item in wired.foreign.model.parameters if "k" in (item.name, *item.aliases)]
    assert [(item.name, item.aliases) for item in springs] == [("k", ("spring.k", "spring.rate"))]
    assert len(set(wired.foreign.parameters)) == len(wired.foreign.parameters)


@pytest.mark.slow
def test_check_counts_a_value_once(tmp_path: Path):
    plain = build_fmu(load_scene("three_cart"), "3.0")
    names = ["variables are consistent", "variables can be read", "start values are obeyed"]
    counts = [
        [row.sentence for row in check_fmu(path, names=names).rows if row.name in names]
        for path in (plain, _in_fmi3(plain, tmp_path / "alias.fmu"))
    ]
    assert counts[0] == counts[1]


@pytest.mark.slow
def test_check_takes_a_dependency_by_any_name(tmp_path: Path):
    """A derivative of FMI 2.0 that declares the alias of a state it depends on."""
    plain = build_fmu(load_scene("three_cart"), "2.0")

    def change(text: str) -> str:
        first = text.index('<ScalarVariable name="v1"')
        variable = text[first : text.index("</ScalarVariable>", first) + len("</ScalarVariable>")]
        alias = variable.replace('name="v1"', 'name="speed"').replace(
            'causality="output"', 'causality="local"'
        )
        place = text.count("<ScalarVariable") + 1
        number = text[:first].count("<ScalarVariable") + 1
        head, mark, tail = text.replace("</ModelVariables>", f"{alias}</ModelVariables>").partition(
            "<ModelStructure>"
        )
        words = [
            f'dependencies="{" ".join(str(place) if word == str(number) else word for word in part.split(chr(34))[0].split())}"{part.partition(chr(34))[2]}'
            for part in tail.split('dependencies="')[1:]
        ]
        return head + mark + tail.split('dependencies="')[0] + "".join(words)

    path = edited(plain, tmp_path / "alias.fmu", change)
    name = "dependencies are complete"
    rows = [row for row in check_fmu(path, names=[name]).rows if row.name == name]
    assert {row.status for row in rows} == {Status.PASSED}, rows

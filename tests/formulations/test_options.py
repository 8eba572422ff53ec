"""Options are read from names and values, or given as an object; what is unknown or impossible is refused in one sentence."""

from dataclasses import asdict, dataclass

import pytest
from wording import unsaid

from formulations.method import OptionError, Options, option, read_options
from formulations.methods.mpcc import MpccOptions
from formulations.methods.softplus_dc import SoftplusDCOptions
from formulations.pipelines import load_method


@dataclass(frozen=True, kw_only=True)
class _Base(Options):
    weight: float = option(1.0, "of the goal", lower=0.0, unit="kg")


@dataclass(frozen=True, kw_only=True)
class _Own(_Base):
    rounds: int = option(3, "most rounds", lower=1, upper=10)
    search: bool = option(True, "whether to search")
    guess: str = option("line", "where it starts", choices=("line", "start"))
    most: int | None = option(None, "none: no limit", lower=1)


def test_defaults_are_filled_in_and_values_kept_as_they_were_given():
    assert list(asdict(_Own())) == ["weight", "rounds", "search", "guess", "most"]
    assert repr(read_options(_Own, {"weight": 2, "search": False}, "m").weight) == "2", "keys of stored results hold what was given"
    assert read_options(_Own, _Own(rounds=2), "m") == read_options(_Own, {"rounds": 2}, "m") == _Own(rounds=2)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"round": 1}, "method m: … no option 'round'; did you mean rounds?"),
        ({"colour": 1}, "method m: … no option 'colour'; it has weight, rounds, search, guess, most."),
        ({"rounds": 11}, "method m: option rounds is 11 … [1, 10]"), ({"rounds": 2.0}, "method m: option rounds is 2.0 … whole number"),
        ({"weight": True}, "method m: option weight is True … [0, inf] kg"), ({"weight": None}, "method m: option weight is None … [0, inf] kg"),
        ({"search": "no"}, "method m: option search is 'no' … True, False"), ({"guess": "end"}, "method m: option guess is 'end' … 'line', 'start'"),
        (_Base(), "method m: … _Own, but _Base were given"),
    ],
)  # fmt: skip
def test_one_sentence_says_what_is_wrong(given, sentence):
    with pytest.raises(OptionError) as caught:
        read_options(_Own, given, "m")
    assert not unsaid(caught.value, sentence)


def test_what_is_impossible_only_for_one_method_is_refused_too():
    for name, given, words in (
        ("randomised_smoothing", {"samples": 3}, "option samples is 3, but must be an even number"),
        ("relu_gd", {"iterations": 2.5}, "option iterations is 2.5, but must be a whole number or left out"),
    ):
        with pytest.raises(OptionError, match=f"method {name}: {words}"):
            load_method(name).read_options(given)


def test_an_object_is_checked_when_it_is_made_and_belongs_to_its_method():
    with pytest.raises(OptionError, match="option search is 3"):
        MpccOptions(search=3)  # pyright: ignore[reportArgumentType] - what is tested
    assert load_method("mpcc").read_options(MpccOptions(search=False)).search is False
    with pytest.raises(OptionError, match="are MpccOptions, but SoftplusDCOptions"):
        load_method("mpcc").read_options(SoftplusDCOptions())

"""The command line as a whole: finds the command, runs it, and puts whatever goes wrong into one sentence and an exit code.

A command is imported when it is used: `--help` and `list` cost neither SymPy nor a solver.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import io
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click

import touchstone
from models.errors import MachineError, TouchstoneError, did_you_mean
from validate.cli.table import say

PROGRAM = "python -m validate"
INSTALLED = "touchstone"  # the same as a program of its own, which shells can complete
_COMPLETE = "_TOUCHSTONE_COMPLETE"
INTERRUPTED = 130
READER_GONE = 141  # as a shell tells SIGPIPE
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# name -> what the overview says; the command itself is `command` in validate/cli/<name>.py.
_COMMANDS = {
    "all": "Run every scene by every pipeline, replay and score each plan, write the report.",
    "run": "Run a campaign of your own: scenes, changes, sweeps and pipelines from a TOML file.",
    "new": "Write a scene file that runs, or a plan that fits a scene.",
    "list": "Scenes, pipelines and methods.",
    "show": "One run of a campaign: its stages, verdict, questions, metrics, options, log and the command that runs it again.",
    "report": "Rebuild results.csv and report.html of a campaign from its records.",
    "replay": "Replay and score anybody's plan, on a scene or on anybody's FMU.",
    "robust": "How much a plan can take: the share of perturbed worlds in which it still arrives.",
    "energy": "Whether a time step follows the energies of a scene.",
    "truth": "What is true of contact, and what our FMU and other simulators make of it.",
    "fmu": "Export a scene as an FMU.",
    "check": "Check any FMU: its files, and how its code behaves.",
}
_EPILOG = """\b
Examples:
  python -m validate all --dry-run
  python -m validate all --quick
  python -m validate all -k "strict and not relaxed"
  python -m validate list

\b
Exit codes:
  0    every required check passed
  1    one failed, or touchstone has a bug and says so
  2    wrong usage or configuration, or nothing selected
  3    a system requirement is missing, which is named
  130  interrupted; the same command resumes
  141  output pipe closed (| head): not all was written

\b
Environment:
  TOUCHSTONE_CACHE   folder of compiled scenes and FMUs
  TOUCHSTONE_DEBUG   1: tracebacks of unexpected errors
  TOUCHSTONE_LINEAR_SOLVER
                     of Ipopt: ldlt (ours) or mumps
  NO_COLOR           no colours
  CC                 the C compiler
"""


class LazyGroup(click.Group):
    """Commands that are imported when they are used. lazy: name -> (module whose `command` it is, what the overview says)."""

    def __init__(
        self, *arguments: Any, lazy: Mapping[str, tuple[str, str]], **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self.lazy = lazy

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names, in the order of the overview."""
        return list(self.lazy)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of this name, imported now; None where there is none."""
        own = super().get_command(ctx, cmd_name)
        if own is not None or cmd_name not in self.lazy:
            return own
        return importlib.import_module(self.lazy[cmd_name][0]).command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does, but `_` is read as `-`, and a name that is none is refused with the nearest one."""
        if args and args[0].replace("_", "-") in self.lazy:
            args = [args[0].replace("_", "-"), *args[1:]]
        if (
            args
            and args[0] not in self.lazy
            and not args[0].startswith("-")
            and not ctx.resilient_parsing
        ):
            hint = did_you_mean(args[0], self.lazy, f"there are {', '.join(self.lazy)}.")
            raise click.UsageError(f"there is no command {args[0]!r}; {hint}", ctx=ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The overview, without importing a command."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in self.lazy.items()])


@click.group(
    cls=LazyGroup,
    lazy={name: (f"validate.cli.{name}", words) for name, words in _COMMANDS.items()},
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="touchstone-contact", prog_name="touchstone")
def group() -> None:
    """Plan through contact by every method of the field, replay each plan through an FMU, and say whether it holds."""


def run(arguments: Sequence[str], command: click.Group = group, program: str = PROGRAM) -> int:
    """Run one command line of a program; the exit code.

    Nothing but TOUCHSTONE_DEBUG=1 lets a traceback through.
    """
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(
                errors="replace"
            )  # a terminal without our characters shows others instead of failing
    if wanted := os.environ.get(_COMPLETE):
        from click.shell_completion import shell_complete

        return shell_complete(group, {}, INSTALLED, _COMPLETE, wanted)
    try:
        return _run(arguments, command, program)
    except BrokenPipeError:
        return _reader_gone()


def _run(arguments: Sequence[str], command: click.Group, program: str) -> int:
    try:
        code = command.main(
            list(arguments), prog_name=program, standalone_mode=False, obj=tuple(arguments)
        )
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx is not None else "", err=True)
        return error.exit_code
    except click.ClickException as error:
        return _say(_sentence(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return _say("interrupted.", INTERRUPTED)
    except TouchstoneError as error:
        mistakes = getattr(error, "mistakes", ())
        if len(mistakes) < 2:
            return _say(str(error), error.exit_code)
        code = _say(f"{getattr(error, 'headline', error)}:", error.exit_code)
        for mistake in mistakes:
            say(mistake, err=True, begin="  ", indent="    ")
        return code
    except BrokenPipeError:
        raise
    except (
        SystemExit
    ):  # click's end of a broken pipe: 1, as if something did not hold, and streams of its own
        if isinstance(sys.stdout, io.TextIOBase):
            raise
        return _reader_gone()
    except Exception as error:
        if os.environ.get("TOUCHSTONE_DEBUG") == "1":
            raise
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            return _say(
                f"{str(error.filename)[:60]!r}..: the disk has no names as long as this; give a shorter one.",
                TouchstoneError.exit_code,
            )
        if isinstance(error, OSError) and error.errno in _FULL:
            why = f"what there is to tell cannot be written ({error.strerror}); make room, or have it written elsewhere."
            _leave_unwritten()
            with contextlib.suppress(OSError):  # where stderr is full too, nothing can be told
                _say(why, MachineError.exit_code)
            _leave_unwritten()
            return MachineError.exit_code
        if (missing := touchstone.not_installed(error)) is not None:
            return _say(missing, MachineError.exit_code)
        return _say(_unexpected(error), 1)
    return code if isinstance(code, int) else 0


def _open_closed_streams() -> None:
    """`>&-` leaves no stream to write to: what is told then goes nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - open until the process ends


def _reader_gone() -> int:
    """Whoever read our output has enough of it."""
    _leave_unwritten()
    return READER_GONE


def _leave_unwritten() -> None:
    """What a stream holds that it cannot write, or is given from now on, as the interpreter ends too, goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.__stdout__, sys.__stderr__):
        if stream is None:
            continue
        try:
            stream.flush()
        except OSError:
            os.dup2(nowhere, stream.fileno())


def _say(sentence: str, code: int) -> int:
    say(sentence, err=True, begin="error: ", indent="  ")
    return code


def _sentence(error: click.ClickException) -> str:
    text = error.format_message()
    if (
        isinstance(error, click.UsageError)
        and error.ctx is not None
        and "did you mean" not in text.lower()
    ):
        text = f"{text.rstrip('.')}; {error.ctx.command_path} --help says what is possible."
    return text[:1].lower() + text[1:]


def _unexpected(error: Exception) -> str:
    import tempfile  # 6 ms, a tenth of `--help`
    import traceback

    where = "TOUCHSTONE_DEBUG=1 shows where"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="touchstone-", suffix=".log", delete=False, encoding="utf-8"
        ) as log:
            traceback.print_exc(file=log)
        where = f"the traceback is in {log.name}"
    except OSError:
        pass
    return f"this should not have happened ({type(error).__name__}: {error}); {where}. Please report it."

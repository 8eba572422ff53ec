"""Find and run the command; turn each error into a sentence and an exit code.

A command is imported on use: `--help` and `list` import neither SymPy nor a solver.
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
from touchstone_annexes import present
from validate.cli.table import say

PROGRAM = "python -m validate"
INSTALLED = "touchstone"  # the installed program, which shells can complete
_COMPLETE = "_TOUCHSTONE_COMPLETE"
INTERRUPTED = 130
READER_GONE = 141  # as shells report SIGPIPE
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# name -> text of the overview; the command is `command` in validate/cli/<name>.py. An annex's
# command may be missing.
_COMMANDS = {
    "all": "Run every scene by every pipeline, replay and score each plan, write the report.",
    "run": "Run a campaign from a TOML file of scenes, changes, sweeps and pipelines.",
    "new": "Write a scene file that runs, or a plan that fits a scene.",
    "list": "List scenes, pipelines, methods and stress cases.",
    "show": "Show a run of a campaign: stages, verdict, questions, metrics, options, log and the command to repeat it.",
    "report": "Rebuild results.csv and report.html of a campaign from its records.",
    "replay": "Replay and score a plan on a scene or an external FMU.",
    "robust": "Measure the share of perturbed worlds in which a plan still arrives.",
    "energy": "Test whether a time step follows the energies of a scene.",
    "truth": "Compare our FMU and other simulators with exact answers of contact problems.",
    "fmu": "Export a scene as an FMU.",
    "check": "Check the files and the behaviour of any FMU.",
}
_MODULES = present({name: f"validate.cli.{name}" for name in _COMMANDS})
_EPILOG = """\b
Examples:
  python -m validate all --dry-run
  python -m validate all --quick
  python -m validate all -k "strict and not relaxed"
  python -m validate list

\b
Exit codes:
  0    every required check passed
  1    a required check failed, or touchstone has a bug
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
    """A group whose commands are imported on use.

    lazy: name -> (module with the attribute `command`, text of the overview).
    """

    def __init__(
        self, *arguments: Any, lazy: Mapping[str, tuple[str, str]], **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self.lazy = lazy

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the overview."""
        return list(self.lazy)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command of this name; None for an unknown name."""
        own = super().get_command(ctx, cmd_name)
        if own is not None or cmd_name not in self.lazy:
            return own
        return importlib.import_module(self.lazy[cmd_name][0]).command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Resolve a command as click does, with `_` read as `-`.

        The message for an unknown name suggests the nearest one.
        """
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
        """Write the overview without importing a command."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in self.lazy.items()])


@click.group(
    cls=LazyGroup,
    lazy={name: (module, _COMMANDS[name]) for name, module in _MODULES.items()},
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="touchstone-contact", prog_name="touchstone")
def group() -> None:
    """Plan through contact, replay each plan through an FMU, and judge whether it holds."""


def run(arguments: Sequence[str], command: click.Group = group, program: str = PROGRAM) -> int:
    """Run one command line of a program; return the exit code.

    Tracebacks appear only with TOUCHSTONE_DEBUG=1.
    """
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(
                errors="replace"
            )  # a terminal without our characters shows replacements
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
    ):  # click ends a broken pipe with 1, the code of a failed check, and its own streams
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
            with contextlib.suppress(OSError):  # stderr may be full too
                _say(why, MachineError.exit_code)
            _leave_unwritten()
            return MachineError.exit_code
        if (missing := touchstone.not_installed(error)) is not None:
            return _say(missing, MachineError.exit_code)
        return _say(_unexpected(error), 1)
    return code if isinstance(code, int) else 0


def _open_closed_streams() -> None:
    """Open os.devnull in place of a stream closed by `>&-`."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - open until the process ends


def _reader_gone() -> int:
    """Discard the rest of the output, because its reader closed the pipe; return the exit code."""
    _leave_unwritten()
    return READER_GONE


def _leave_unwritten() -> None:
    """Send unwritten and later output of the streams to os.devnull.

    Otherwise the interpreter fails at exit.
    """
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

"""`house`: how large and how tangled the code is, in numbers that a change can be held against.

Counted is what git tracks. A circle is a set of modules that import each other, annotations and
imports inside functions counted.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import click
import networkx as nx

from benchmarks import ROOT
from validate.cli.table import table

ROOMS = ("models", "formulations", "validate", "reports")
SUFFIXES = (".py", ".c", ".h", ".j2", ".js", ".css", ".html")
# Folders of which each file is one of a kind: as many as there are.
CATALOGS = frozenset(
    {
        "models/scenes",
        "formulations/methods",
        "validate/cli",
        "validate/stress/cases",
        "reports/pages",
        "reports/templates",
    }
)
# Where one run begins: what is reachable from here a reader may come to.
RUN = "validate.tasks.path"
_QUIET = frozenset(
    {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
)
_SHAPE = re.compile(r"\([\w*+ -]+(, ?[\w*+ -]+)*,?\)")
_UNIT = re.compile(r"\[[\w^/ .,-]+\]")
_ERRORS = re.compile(r"[Rr]aises")


def _tracked() -> list[str]:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    return [name for name in listed if name.endswith(SUFFIXES) and (ROOT / name).is_file()]


def _documented(
    tree: ast.AST,
) -> Iterator[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and ast.get_docstring(node) is not None
        ):
            yield node


def code_lines(text: str) -> int:
    """Lines with code on them: no blank ones, comments or docstrings."""
    told = {
        line
        for node in _documented(ast.parse(text))
        for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
    }
    tokens = (
        token
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in _QUIET
    )
    return len(
        {line for token in tokens for line in range(token.start[0], token.end[0] + 1)} - told
    )


def _imports(tree: ast.AST, modules: frozenset[str]) -> Iterator[tuple[str, bool]]:
    """Modules of ours that a tree imports, and whether inside a function."""
    inside = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for part in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for name in node.names:
                wanted = f"{node.module}.{name.name}"
                yield (wanted if wanted in modules else node.module), id(node) in inside
        elif isinstance(node, ast.Import):
            for name in node.names:
                yield name.name, id(node) in inside


def measure() -> dict[str, str]:
    """Each figure by what it is of."""
    files = _tracked()
    ours = [name for name in files if name.split("/")[0] in ROOMS]
    texts = {
        name: (ROOT / name).read_text(encoding="utf-8") for name in files if name.endswith(".py")
    }
    trees = {
        name.removesuffix(".py").removesuffix("/__init__").replace("/", "."): ast.parse(texts[name])
        for name in ours
        if name in texts
    }
    modules = frozenset(trees)
    found = {
        module: [pair for pair in _imports(tree, modules) if pair[0] in modules]
        for module, tree in trees.items()
    }
    graph = nx.DiGraph(
        [
            (module, other)
            for module, pairs in found.items()
            for other, _ in pairs
            if other != module
        ]
    )
    folders = Counter(Path(name).parent.as_posix() for name in ours)
    largest, most = max(
        ((folder, count) for folder, count in folders.items() if folder not in CATALOGS),
        key=lambda item: item[1],
    )
    homes: defaultdict[str, set[str]] = defaultdict(set)
    for module, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].add(module)
    arrays = [
        ast.get_docstring(node) or ""
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("_")
        and "ndarray" in ast.unparse(node.args) + ast.unparse(node.returns or node.args)
    ]
    circles = [part for part in nx.strongly_connected_components(graph) if len(part) > 1]
    return {
        "Python code lines of the four rooms": str(
            sum(code_lines(texts[name]) for name in ours if name in texts)
        ),
        "files of the four rooms": str(len(ours)),
        "loose Python files in validate/": str(
            sum(name.count("/") == 1 for name in ours if name.startswith("validate/"))
        ),
        "largest folder but the catalogs": f"{most} ({largest})",
        "modules of ours that a run may reach": str(len(nx.descendants(graph, RUN)) + 1),
        "circles (modules in them)": f"{len(circles)} ({sum(map(len, circles))})",
        "imports of ours inside functions": str(
            sum(hidden for pairs in found.values() for _, hidden in set(pairs))
        ),
        "class names with two meanings": str(sum(len(places) > 1 for places in homes.values())),
        "public functions of arrays whose docstring gives shape, unit, errors": ", ".join(
            f"{100 * sum(bool(pattern.search(text)) for text in arrays) / len(arrays):.0f} %"
            for pattern in (_SHAPE, _UNIT, _ERRORS)
        ),
        "Python lines of the tests": str(
            sum(texts[name].count("\n") for name in texts if name.startswith("tests/"))
        ),
    }


@click.command()
def command() -> int:
    """How large and how tangled the code is."""
    click.echo(table(["", "now"], [list(item) for item in measure().items()]))
    return 0

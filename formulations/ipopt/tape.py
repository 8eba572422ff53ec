"""Record the arithmetic of a term shape as instructions that tape.c runs over all its instances.

    tape = record(graph, outputs, hoisted, row)
    tape.run(x, columns, data, scale, place, total)  # total[place] += scale * outputs

A register holds a few instances, so that it stays in the L1 cache.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from formulations.ipopt.graph import CONSTANT, DATUM, SEED, UNARY, VARIABLE, Graph
from models.codegen.compiler import cached_library, load_library

_SOURCE = Path(__file__).with_name("tape.c")
_OPTIMISED = ("-O3",)
_SIGNATURES = {"run_tape": ("n", "npnpnnn" + "p" * 6)}
# In the order of tape.c.
_INSTRUCTIONS = (
    *("out", "add", "sub", "mul", "div", "pow", "neg", "sqrt"),
    *(name for name in UNARY if name != "sqrt"),
    *("softplus", "logistic", "sech2", "falling_power"),
)
_CODE = {name: code for code, name in enumerate(_INSTRUCTIONS)}


@cache
def _library() -> ctypes.CDLL:
    """Compile tape.c, or load it from the disk cache; raise MachineError without a compiler."""
    sources = {_SOURCE.name: _SOURCE.read_text(encoding="utf-8")}
    return load_library(cached_library(sources, _OPTIMISED), _SIGNATURES)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tape:
    """instructions (length, 4) int32, numbers (count,), and the sizes of its arrays."""

    instructions: np.ndarray
    numbers: np.ndarray
    outputs: int
    variables: int
    registers: int

    def run(
        self,
        x: np.ndarray,
        columns: np.ndarray,
        data: np.ndarray,
        scale: np.ndarray,
        place: np.ndarray,
        total: np.ndarray,
    ) -> None:
        """Add scale times each output to its place in `total`, NaN or inf if a term has no number.

        - x: (n,) point
        - columns: (variables, instances) place in x of each variable
        - data: (data, instances) rows of the hoisted nodes
        - scale: (instances,)
        - place: (outputs, instances) place in `total` of each output; negative places are skipped
        - total: (m,) changed in place

        Arrays are contiguous, of float64 or int32; sizes are not checked. Raises MachineError
        without a C compiler, MemoryError if the registers do not fit into memory.
        """
        done = _library().run_tape(
            len(self.instructions),
            self.instructions.ctypes.data,
            len(self.numbers),
            self.numbers.ctypes.data,
            self.variables,
            self.registers,
            len(scale),
            *(array.ctypes.data for array in (x, columns, data, scale, place, total)),
        )
        if not done:
            raise MemoryError(f"no room for {self.registers} registers")


def record(
    graph: Graph,
    outputs: Sequence[int],
    hoisted: Mapping[int, int],
    row: Mapping[int, int],
) -> Tape:
    """Return the tape whose k-th output is the node outputs[k].

    `hoisted[node]` is the data row of a hoisted node (a seed too); `row[i]` is the row of variable
    i in the columns.
    """
    order = graph.reachable(*outputs, until=hoisted.__contains__)
    for node in order:
        if graph.op[node] in (DATUM, SEED) and node not in hoisted:
            raise ValueError(f"{graph.op[node]} {graph.args[node][0]} is used but was not hoisted")
    numbers = [node for node in order if graph.op[node] == CONSTANT]
    place = {node: k for k, node in enumerate(numbers)}
    first = len(numbers) + len(row)  # first reusable register
    steps: list[tuple[int, ...]] = []
    last: dict[int, int] = {}
    places: dict[int, list[int]] = {}
    for k, node in enumerate(outputs):
        places.setdefault(node, []).append(k)
    for node in order:
        if node in hoisted:
            place[node] = -1 - hoisted[node]
        elif graph.op[node] == VARIABLE:
            place[node] = len(numbers) + row[graph.args[node][0]]
        elif graph.op[node] != CONSTANT:
            last.update(dict.fromkeys(graph.args[node], node))
    ready: dict[int, list[int]] = {}
    for operand, node in last.items():
        ready.setdefault(node, []).append(operand)
    free: list[int] = []
    registers = first
    for node in order:
        if node not in place:
            if free:
                place[node] = free.pop()
            else:
                place[node], registers = registers, registers + 1
            steps.append(_instruction(graph, node, place))
            free += [place[a] for a in ready.get(node, ()) if place[a] >= first]
        steps += [(_CODE["out"], k, place[node], 0) for k in places.get(node, ())]
        if node not in last and place[node] >= first:
            free.append(place[node])
    return Tape(
        instructions=np.array(steps, dtype=np.int32).reshape(-1, 4),
        numbers=np.array([graph.args[node][0] for node in numbers], dtype=float),
        outputs=len(outputs),
        variables=len(row),
        registers=registers,
    )


def _instruction(graph: Graph, node: int, place: Mapping[int, int]) -> tuple[int, ...]:
    operands = [place[a] for a in graph.args[node]]
    code = _CODE[graph.op[node]]
    if graph.op[node] == "falling_power":
        code += int(graph.args[graph.args[node][2]][0])
    return code, place[node], operands[0], operands[1] if len(operands) > 1 else 0

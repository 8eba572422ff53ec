"""Reference results inside the FMU by the layered standard FMI-LS-REF: an experiment, its inputs, and the true motion.

The inputs push and pull so that contacts close and open; they are constant between knots, at which the CSV has the time
twice. The results are those of `reference.py`, not of the FMU. They are kept: to integrate two fingers takes several CPU s, and FMUs of every
version and platform have the same. Where the motion cannot be followed within the budget there are none, and the description says why.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from models.codegen.kept import kept_text
from models.fmu.reference import Equations, MotionError, Piece, true_motion_and_method
from models.fmu.rendering import render
from models.fmu.variables import variable_table
from models.scene import Input, Scene

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
# Rows of the results, about: the experiment lasts as long as the task, in steps that are whole multiples of the task's.
_ROWS = 200
# Inputs in each quarter of the experiment, as a share of `_strength`; the next input has them with the other sign.
_SHARES = (1.0, -0.5, 0.0, 0.75)
# Largest difference that a right simulation should have from the results, relative to the nominal of a state.
ACCURACY = 1e-6
_UNWANTED = "this FMU was made to replay a plan, which needs none."


def experiment_texts(scene: Scene, results: bool = True) -> dict[str, str]:
    """Path inside the FMU -> text of each file of the layered standard. results: whether to integrate for them."""
    stride = -(-scene.task.steps // _ROWS)
    step, count = scene.task.step * stride, scene.task.steps // stride
    pieces = _pieces(scene, step, count)
    kept = _UNWANTED
    if results:
        kept = kept_text(scene, "reference.csv", lambda: _results(scene, pieces, np.arange(count + 1) * step), whole=True)
    # The first line says how the results came about, or why there are none.
    told, _, csv = kept.partition("\n")
    texts = {
        "fmi-ls-manifest.xml": render("fmi-ls-manifest.xml.j2", scene=scene, results=csv),
        "validation.exp": render("experiment.xml.j2", scene=scene, stop=step * count, step=step, accuracy=ACCURACY, results=csv),
    }
    if csv:
        texts["validation_results.csv"] = csv
    if scene.inputs:
        texts["validation_inputs.csv"] = _inputs(scene, pieces)
    files = {f"{FOLDER}/{name}": text for name, text in texts.items()}
    page = render("fmi-ls-ref.html.j2", scene=scene, accuracy=ACCURACY, folder=FOLDER, results=csv, told=told)
    return files | {"documentation/fmi-ls-ref.html": page}


def _strength(item: Input) -> float:
    """Half of what the actuator can do, or 1 in its unit if nothing bounds it."""
    bounds = [abs(bound) for bound in (item.lower, item.upper) if np.isfinite(bound) and bound != 0]
    return 0.5 * min(bounds) if bounds else 1.0


def _pieces(scene: Scene, step: float, count: int) -> list[Piece]:
    strength = np.array([_strength(item) * (-1) ** index for index, item in enumerate(scene.inputs)])
    if not scene.inputs:
        return [Piece(step * count, strength)]
    ends = [step * round(count * (quarter + 1) / len(_SHARES)) for quarter in range(len(_SHARES))]
    return [Piece(end, share * strength) for end, share in zip(ends, _SHARES, strict=True)]


def _inputs(scene: Scene, pieces: Sequence[Piece]) -> str:
    rows, begin = [], 0.0
    for piece in pieces:
        rows += [(begin, *piece.u), (piece.end, *piece.u)]
        begin = piece.end
    return _csv(["time", *(item.name for item in scene.inputs)], rows)


def _results(scene: Scene, pieces: Sequence[Piece], times: np.ndarray) -> str:
    """How they came about, and from the second line on the CSV; without it why there is none."""
    equations = Equations(scene)
    try:
        states, method = true_motion_and_method(equations, pieces, times)
    except MotionError as error:
        return f"{error}\n"
    outputs = [variable.name for variable in variable_table(scene) if variable.causality == "output"]
    names = [coordinate.name for coordinate in scene.coordinates] + [coordinate.velocity_name for coordinate in scene.coordinates]
    # At a knot the inputs are those that end there, as in a simulation that has just reached it.
    held = [next((piece.u for piece in pieces if t <= piece.end), pieces[-1].u) for t in times]
    rows = []
    for t, x, u in zip(times, states, held, strict=True):
        values = equations.outputs(x, u) | dict(zip(names, x, strict=True))
        rows.append((t, *(values[name] for name in outputs)))
    told = f"{method.words} integrated the equations with a relative tolerance of {method.tolerance:.0e}"
    return f"{told}\n{_csv(['time', *outputs], rows)}"


def _csv(header: Sequence[str], rows: Iterable[Sequence[float]]) -> str:
    """Ten digits: below the accuracy, and the same on every machine."""
    lines = [",".join(header)]
    lines += [",".join("0" if value == 0 else f"{value:.10g}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"

"""Write and read plans in NetCDF-4 files, one variable per column, named as in the scene.

The file also contains the gaps of contacts and the poses of shapes at the nodes (models.kinematics)
in single precision, for reports without the scene, and optional tracking gains K (steps, nu, 2*nq)
as columns `gain_<input>_<position or velocity>`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.errors import TrajectoryError
from models.kinematics import gap_columns, pose_columns
from models.netcdf import Column, as_columns, numbers, read_columns, write_columns
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, columns_of

_CONTENT = "touchstone plan"


def write_netcdf(
    path: Path, trajectory: Trajectory, scene: Scene, gains: np.ndarray | None = None
) -> None:
    """Write a plan, and its tracking gains.

    gains: K (steps, nu, 2*nq) of u = u_plan + K (x_plan - x) [N/m, N s/m and so on], or None
    Raises TrajectoryError if they do not fit the scene, MachineError if the file cannot be written.
    """
    trajectory.check_fits(scene)
    columns = [
        Column(name="t", dimension="node", values=trajectory.t, unit="s", description="time")
    ]
    groups = columns_of(scene)
    for field, group in groups.items():
        columns += as_columns(
            group, getattr(trajectory, field), "node" if field in ("q", "v") else "step"
        )
    columns += [
        *gap_columns(scene, trajectory.q, "node"),
        *pose_columns(scene, trajectory.q, "node"),
    ]
    if gains is not None:
        expected = (trajectory.steps, scene.nu, 2 * scene.nq)
        if gains.shape != expected:
            raise TrajectoryError(
                f"file {path}: the tracking gains have shape {gains.shape}, but {expected} is needed."
            )
        states = [*groups["q"], *groups["v"]]
        named = [
            (f"gain_{item.name}_{name}", f"({item.unit})/({unit})", "tracking gain")
            for item in scene.inputs
            for name, unit, _ in states
        ]
        columns += as_columns(named, gains.reshape(trajectory.steps, -1), "step")
    write_columns(
        path,
        columns,
        {"content": _CONTENT, "scene": scene.name, "hold": trajectory.hold.value}
        | ({} if trajectory.scheme is None else {"scheme": trajectory.scheme.value})
        | ({"missing": " ".join(sorted(trajectory.missing))} if trajectory.missing else {})
        | (
            {}
            if trajectory.u_end is None
            else {"u_end": " ".join(repr(float(value)) for value in trajectory.u_end)}
        ),
    )


def read_netcdf(path: Path, scene: Scene, of: str | None = None) -> Trajectory:
    """Read a plan of this scene, written for a scene called `of` (None: of the same name).

    Raises TrajectoryError naming the file and the column.
    """
    columns, attributes = read_columns(path)
    if attributes.get("content") != _CONTENT:
        raise TrajectoryError(
            f"file {path}: it holds {attributes.get('content', 'something else')!r}, not a plan."
        )
    if attributes.get("scene") != (of or scene.name):
        raise TrajectoryError(
            f"file {path}: it holds a plan of scene {attributes.get('scene')!r}, not of {of or scene.name!r}."
        )
    for kind, name in ((Hold, "hold"), (Scheme, "scheme")):
        known = [item.value for item in kind]
        if attributes.get(name) not in (known if name == "hold" else [*known, None]):
            raise TrajectoryError(
                f"file {path}: {name} is {attributes.get(name)!r}, but must be one of {', '.join(known)}."
            )
    hold, scheme = (
        Hold(attributes["hold"]),
        Scheme(attributes["scheme"]) if "scheme" in attributes else None,
    )
    t = numbers(path, columns, "t", "s")
    arrays = {}
    for field, group in columns_of(scene).items():
        size = len(t) if field in ("q", "v") else max(len(t) - 1, 0)
        stacked = [numbers(path, columns, name, unit, size) for name, unit, _ in group]
        arrays[field] = np.column_stack(stacked) if stacked else np.zeros((size, 0))
    try:
        missing = frozenset(str(attributes.get("missing", "")).split())
        u_end = (
            np.array([float(word) for word in str(attributes["u_end"]).split()])
            if "u_end" in attributes
            else None
        )
        plan = Trajectory(t=t, hold=hold, scheme=scheme, missing=missing, u_end=u_end, **arrays)
        plan.check_fits(scene)
        return plan
    except TrajectoryError as error:
        raise TrajectoryError(f"{error} (file {path})") from error

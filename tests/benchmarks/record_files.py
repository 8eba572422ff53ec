"""What benchmarks would leave in DIR: made up from power laws, so that every sentence can be worked out by hand."""

import json
from pathlib import Path

STEPS = (1e-2, 1e-3, 1e-4, 1e-5)
# Master -> (size at h = 1 s, order) of the energy error.
ORDERS = {
    "jacobi": (100.0, 1),
    "contact_first": (30.0, 1),
    "extrapolated": (1e3, 2),
    "iterated": (100.0, 2),
}


def cosim(title: str = "Two masses meet", **changes) -> dict:
    """One case with omega = 100 rad/s; the whole scene is right to 1e-10, ECCO failed."""

    def rows(size, order):
        return [
            {
                "h": h,
                "mean_step": h,
                "energy_error": size * h**order,
                "momentum_error": 1e-14,
                "position_error": h,
                "cpu_per_s": 1e-5 / h,
            }
            for h in STEPS
        ]

    masters = [{"name": name, "rows": rows(*law), "failed": ""} for name, law in ORDERS.items()]
    masters += [{"name": "whole", "rows": rows(1e-10, 0), "failed": ""}]
    masters += [{"name": "libcosim_ecco", "rows": [], "failed": "libcosimpy is not installed"}]
    case = {
        "name": "head_on",
        "title": title,
        "frequency": 100.0,
        "horizon": 0.2,
        "masters": masters,
    }
    return {"kind": "cosim", "cases": [case | changes]}


def speed(name: str = "three_cart") -> dict:
    """Model Exchange: error rtol in sqrt-free seconds.

    Co-Simulation of order 1, one row that failed.
    """
    sweep = [
        {
            "kind": "Model Exchange, rtol",
            "setting": rtol,
            "cpu_s": 0.1,
            "error_m": rtol,
            "outcome": "completed",
        }
        for rtol in (1e-4, 1e-7, 1e-10)
    ]
    sweep += [
        {
            "kind": "Co-Simulation, heun",
            "setting": n,
            "cpu_s": 1e-4 * n,
            "error_m": 1e-3 / n,
            "outcome": "completed",
        }
        for n in (1, 10, 100)
    ]
    sweep.append(
        {
            "kind": "Co-Simulation, heun",
            "setting": 1000,
            "cpu_s": 0.1,
            "error_m": None,
            "outcome": "not_a_number",
        }
    )
    figures = {
        "name": name,
        "default_cpu_s": 0.5,
        "reference_cpu_s": 0.4,
        "everyday_cpu_s": 0.1,
        "parent_cpu_s_of_a_child": 0.1,
    }
    return {
        "kind": "replay_speed",
        "scenes": [
            figures
            | {
                "self_error_m": 2e-10,
                "closed_form_relative_errors": {"restitution": 3e-12},
                "sweep": sweep,
            }
        ],
    }


def scaling(exponent: float = 1.0) -> dict:
    """Two stages over three sizes: one whose time is a power of n T, one that is not solved at its largest size."""
    sizes = ((3, 500), (3, 5000), (10, 5000))

    def stage(name: str, rows: list[dict], time: float | None) -> dict:
        return {
            "name": name,
            "time_exponent": time,
            "iteration_exponent": time,
            "memory_exponent": 1.0,
            "rows": rows,
        }

    def row(n: int, steps: int, cpu: float | None, outcome: str = "solved") -> dict:
        memory = None if cpu is None else n * steps / 100
        return {
            "n": n,
            "steps": steps,
            "cpu_s": cpu,
            "memory_mib": memory,
            "iterations": 1,
            "outcome": outcome,
            "cost": None,
        }

    done = [row(n, steps, 1e-6 * (n * steps) ** exponent) for n, steps in sizes]
    cut = [*done[:2], row(10, 5000, None, "no answer in 900 s")]
    return {
        "kind": "scaling",
        "stages": [stage("gd_iteration", done, exponent), stage("mpec_step", cut, None)],
    }


def order() -> dict:
    """Euler's replay error is h, Radau's h^3, both for 1e-3/h CPU s: 1e-3 m takes Euler 1 s, Radau 0.01 s. The finest Radau grid is not solved."""

    def row(scheme: str, steps: int, power: int) -> dict:
        h, solved = 1.0 / steps, (scheme, steps) != ("radau_iia_2", 1000)
        found = {
            "scheme": scheme, "steps": steps, "h": h, "outcome": "solved" if solved else "stalled",
            "cpu_s": 1e-3 * steps, "iterations": 9,
        }  # fmt: skip
        error = h**power if solved else None
        switch = h**2 if solved and power == 3 else None
        return found | {
            "cost": 1.0 if solved else None,
            "replay_error": error,
            "plan_error": error,
            "switch_error": switch,
        }

    rows = [
        row(scheme, steps, power)
        for scheme, power in (("semi_implicit_euler", 1), ("radau_iia_2", 3))
        for steps in (10, 100, 1000)
    ]
    radau = {"scheme": "radau_iia_2", "steps": 10, "cpu_s": 0.01, "replay_error": 1e-3}
    euler = {"scheme": "semi_implicit_euler", "steps": 1000, "cpu_s": 1.0, "replay_error": 1e-3}
    answers = [
        {"target": 1e-3, "best": radau, "euler": euler},
        {
            "target": 1e-4,
            "best": radau | {"steps": 100, "cpu_s": 0.1, "replay_error": 1e-6},
            "euler": None,
        },
        {"target": 1e-7, "best": None, "euler": None},
    ]
    scene = {
        "name": "three_cart",
        "unit": "m",
        "horizon": 1.0,
        "orders": {"semi_implicit_euler": 1.0, "radau_iia_2": None},
    }
    return {"kind": "order", "scenes": [scene | {"rows": rows, "answers": answers}]}


def leave(folder: Path, *records: dict) -> None:
    folder.mkdir(exist_ok=True)
    for place, record in enumerate(records):
        (folder / f"{record.get('kind', 'odd')}-{place}.json").write_text(
            json.dumps(record), encoding="utf-8"
        )

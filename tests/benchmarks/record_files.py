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


def leave(folder: Path, *records: dict) -> None:
    folder.mkdir(exist_ok=True)
    for place, record in enumerate(records):
        (folder / f"{record.get('kind', 'odd')}-{place}.json").write_text(
            json.dumps(record), encoding="utf-8"
        )

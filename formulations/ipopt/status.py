"""Ipopt's return codes -> Outcome. One map; a code that is not in it is FAILED, never success."""

from __future__ import annotations

from types import MappingProxyType

from formulations.solution import Outcome

# Ipopt's ApplicationReturnStatus (IpReturnCodes_inc.h), complete as of Ipopt 3.14.
STATUS_NAMES = MappingProxyType({
    0: "Solve_Succeeded",
    1: "Solved_To_Acceptable_Level",
    2: "Infeasible_Problem_Detected",
    3: "Search_Direction_Becomes_Too_Small",
    4: "Diverging_Iterates",
    5: "User_Requested_Stop",
    6: "Feasible_Point_Found",
    -1: "Maximum_Iterations_Exceeded",
    -2: "Restoration_Failed",
    -3: "Error_In_Step_Computation",
    -4: "Maximum_CpuTime_Exceeded",
    -5: "Maximum_WallTime_Exceeded",
    -10: "Not_Enough_Degrees_Of_Freedom",
    -11: "Invalid_Problem_Definition",
    -12: "Invalid_Option",
    -13: "Invalid_Number_Detected",
    -100: "Unrecoverable_Exception",
    -101: "NonIpopt_Exception_Thrown",
    -102: "Insufficient_Memory",
    -199: "Internal_Error",
})  # fmt: skip

# SOLVED here is Ipopt's opinion; `solve` keeps it only if the unscaled residuals agree.
STATUS_MAP = MappingProxyType({
    0: Outcome.SOLVED,
    1: Outcome.SOLVED,
    2: Outcome.INFEASIBLE,
    3: Outcome.STALLED,
    4: Outcome.DIVERGED,
    5: Outcome.INTERRUPTED,
    6: Outcome.SOLVED,
    -1: Outcome.ITERATION_LIMIT,
    -2: Outcome.STALLED,
    -3: Outcome.STALLED,
    -4: Outcome.TIME_LIMIT,
    -5: Outcome.TIME_LIMIT,
    -10: Outcome.REFUSED,
    -11: Outcome.REFUSED,
    -12: Outcome.FAILED,
    -13: Outcome.EVALUATION_ERROR,
    -100: Outcome.FAILED,
    -101: Outcome.FAILED,
    -102: Outcome.CRASHED,
    -199: Outcome.CRASHED,
})  # fmt: skip

# The status of a problem that was decided without Ipopt: nothing to optimise, contradicting bounds, a false constraint of numbers.
NOT_SENT = -1000


def outcome_of(status: int) -> Outcome:
    """The outcome Ipopt's code claims; FAILED for a code that nobody has named."""
    return STATUS_MAP.get(status, Outcome.FAILED)


def name_of(status: int) -> str:
    return "decided without Ipopt" if status == NOT_SENT else STATUS_NAMES.get(status, f"unknown Ipopt status {status}")

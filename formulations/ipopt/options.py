"""The Ipopt options that a user may set, with their types.

This is a list because some options end the process (a missing HSL library, Mehrotra's algorithm
on a general problem), and because a misspelt option must fail before the solve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from formulations.ipopt.linear_solver import LINEAR_SOLVERS
from models.errors import did_you_mean


class UnknownOptionError(ValueError):
    """An option that is not on the list, or a value that the option cannot have."""


_YES_NO = ("yes", "no")

_REALS = (
    "acceptable_compl_inf_tol", "acceptable_constr_viol_tol", "acceptable_dual_inf_tol",
    "acceptable_obj_change_tol", "acceptable_tol",
    "adaptive_mu_kkterror_red_fact", "alpha_for_y_tol", "alpha_min_frac", "alpha_red_factor",
    "barrier_tol_factor", "bound_frac",
    "bound_mult_init_val", "bound_push", "bound_relax_factor", "compl_inf_tol",
    "constr_mult_init_max", "constr_mult_reset_threshold",
    "constr_viol_tol", "corrector_compl_avrg_red_fact", "delta", "diverging_iterates_tol",
    "dual_inf_tol", "eta_phi",
    "expect_infeasible_problem_ctol", "expect_infeasible_problem_ytol",
    "first_hessian_perturbation", "gamma_phi", "gamma_theta",
    "jacobian_regularization_exponent", "jacobian_regularization_value", "kappa_d", "kappa_sigma",
    "kappa_soc",
    "max_cpu_time", "max_hessian_perturbation", "max_wall_time", "min_hessian_perturbation",
    "mu_init", "mu_linear_decrease_factor",
    "mu_max", "mu_max_fact", "mu_min", "mu_superlinear_decrease_power", "mu_target",
    "mumps_dep_tol", "mumps_pivtol", "mumps_pivtolmax",
    "nlp_lower_bound_inf", "nlp_upper_bound_inf", "nlp_scaling_constr_target_gradient",
    "nlp_scaling_max_gradient",
    "nlp_scaling_min_value", "nlp_scaling_obj_target_gradient", "nu_inc", "nu_init", "obj_max_inc",
    "obj_scaling_factor",
    "perturb_dec_fact", "perturb_inc_fact", "perturb_inc_fact_first", "print_frequency_time",
    "recalc_y_feas_tol",
    "required_infeasibility_reduction", "resto_failure_feasibility_threshold",
    "resto_penalty_parameter", "resto_proximity_weight",
    "s_max", "s_phi", "s_theta", "sigma_max", "sigma_min", "slack_bound_frac", "slack_bound_push",
    "slack_move",
    "soft_resto_pderror_reduction_factor", "tau_min", "theta_max_fact", "theta_min_fact",
    "tiny_step_tol", "tiny_step_y_tol", "tol",
    "warm_start_bound_frac", "warm_start_bound_push", "warm_start_mult_bound_push",
    "warm_start_mult_init_max",
    "warm_start_slack_bound_frac", "warm_start_slack_bound_push", "warm_start_target_mu",
)  # fmt: skip

_INTEGERS = (
    "acceptable_iter", "accept_after_max_steps", "adaptive_mu_kkterror_red_iters",
    "filter_reset_trigger", "limited_memory_max_history",
    "limited_memory_max_skipping", "max_filter_resets", "max_iter", "max_refinement_steps",
    "max_resto_iter", "max_soc",
    "max_soft_resto_iters", "min_refinement_steps", "mumps_mem_percent", "mumps_permuting_scaling",
    "mumps_pivot_order", "mumps_scaling",
    "num_linear_variables", "print_frequency_iter", "print_level",
    "quality_function_max_section_steps",
    "watchdog_shortened_iter_trigger", "watchdog_trial_iter_max",
)  # fmt: skip

_SWITCHES = (
    "accept_every_trial_step", "adaptive_mu_restore_previous_iterate",
    "check_derivatives_for_naninf", "evaluate_orig_obj_at_resto_trial",
    "expect_infeasible_problem", "fast_step_computation", "grad_f_constant", "hessian_constant",
    "honor_original_bounds",
    "jac_c_constant", "jac_d_constant", "least_square_init_duals", "least_square_init_primal",
    "linear_scaling_on_demand", "mu_allow_fast_monotone_decrease",
    "neg_curv_test_reg", "perturb_always_cd", "print_info_string", "print_timing_statistics",
    "print_user_options", "recalc_y", "sb",
    "skip_corr_if_neg_curv", "start_with_resto", "timing_statistics", "warm_start_entire_iterate",
    "warm_start_init_point",
    "warm_start_same_structure",
)  # fmt: skip

_CHOICES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(_SWITCHES, _YES_NO),
    "adaptive_mu_globalization": ("obj-constr-filter", "kkt-error", "never-monotone-mode"),
    "alpha_for_y": (
        "primal", "bound-mult", "min", "max", "full", "min-dual-infeas", "safer-min-dual-infeas",
        "primal-and-full", "dual-and-full", "acceptor",
    ),
    "bound_mult_init_method": ("constant", "mu-based"),
    "constraint_violation_norm_type": ("1-norm", "2-norm", "max-norm"),
    "corrector_type": ("none", "affine", "primal-dual"),
    "fixed_mu_oracle": ("probing", "loqo", "quality-function", "average_compl"),
    "fixed_variable_treatment": ("make_parameter", "make_parameter_nodual", "make_constraint",
                                 "relax_bounds"),
    "hessian_approximation": ("exact", "limited-memory"),
    "inf_pr_output": ("internal", "original"),
    "limited_memory_update_type": ("bfgs", "sr1"),
    "line_search_method": ("filter", "cg-penalty", "penalty"),
    "linear_system_scaling": ("none", "slack-based"),
    "mu_oracle": ("probing", "loqo", "quality-function"),
    "mu_strategy": ("monotone", "adaptive"),
    "nlp_scaling_method": ("none", "gradient-based", "equilibration-based"),
}  # fmt: skip

# Options with a reason for the refusal. These end the process in the builds that pip installs.
_REFUSED = MappingProxyType({
    "mehrotra_algorithm": "it ends the process on problems that are not linear or convex quadratic",
    "hsllib": "HSL libraries are not part of the installed Ipopt",
    "option_file_name": "options come from the call alone, so that the record of a run is complete",
    "output_file": "use tee, or print_level with a redirected output",
    "derivative_test": "derivatives are exact and tested; the check prints to the terminal only",
})  # fmt: skip

# Ipopt's own defaults hold otherwise; alternatives needed more iterations on the softplus carts
# (500 steps, eps = 1e-3, 1e-5, 1e-7, straight-line start). Default: 7, 30, 95.
# `mu_strategy=adaptive`: 5, 32, none within 30 s. `limited-memory` Hessian: 11, 41, 290.
# `mu_init=1e-2`: 7, 37, 228. `least_square_init_primal=yes`: 18, 31, 28 (an alternative for stiff
# problems with a distant start). `sb` and `print_level` silence the terminal. An empty
# `option_file_name` ignores an ipopt.opt in the working directory.
DEFAULTS: Mapping[str, str | int | float] = MappingProxyType(
    {"print_level": 0, "sb": "yes", "option_file_name": ""}
)

# A primal-dual warm start keeps its point; Ipopt's default of 1e-3 would push it into the interior.
WARM_START_DEFAULTS: Mapping[str, str | int | float] = MappingProxyType({
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
})  # fmt: skip


def known_options() -> tuple[str, ...]:
    """Return the names of the options that may be set, sorted."""
    return tuple(sorted({*_REALS, *_INTEGERS, *_CHOICES, "linear_solver"}))


def checked_options(options: Mapping[str, Any]) -> dict[str, str | int | float]:
    """Return the options with Ipopt's types; raise UnknownOptionError with advice."""
    return {name: _checked(name, value) for name, value in options.items()}


def _checked(name: str, value: Any) -> str | int | float:
    if name in _REFUSED:
        raise UnknownOptionError(f"the Ipopt option '{name}' cannot be set here: {_REFUSED[name]}")
    if name == "linear_solver":
        if value in LINEAR_SOLVERS:
            return str(value)
        raise UnknownOptionError(
            f"linear_solver '{value}' is not in the installed Ipopt, which would end the process: use {' or '.join(map(repr, LINEAR_SOLVERS))}"
        )
    if name in _CHOICES:
        word = (
            ("yes" if value else "no")
            if isinstance(value, bool) and _CHOICES[name] == _YES_NO
            else str(value)
        )
        if word not in _CHOICES[name]:
            raise UnknownOptionError(
                f"the Ipopt option '{name}' is one of {', '.join(_CHOICES[name])}, not {value!r}"
            )
        return word
    if name in _REALS or name in _INTEGERS:
        return _number(name, value)
    hint = did_you_mean(name, [*known_options(), *_REFUSED], "none that can be set here is like it")
    raise UnknownOptionError(f"there is no Ipopt option '{name}': {hint}")


# Ipopt stores integers in 32 bits.
_LARGEST = 2**31 - 1


def _number(name: str, value: Any) -> int | float:
    whole = name in _INTEGERS
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if (
        isinstance(value, bool)
        or math.isnan(number)
        or (whole and not (number.is_integer() and abs(number) <= _LARGEST))
    ):
        kind = f"a whole number of at most {_LARGEST}" if whole else "a number"
        raise UnknownOptionError(f"the Ipopt option '{name}' is {kind}, not {value!r}")
    return int(number) if whole else number

"""Each seeded defect of event mode, early return, intermediate update and input derivatives is found, and by the check that is there for it."""

import pytest

_STEPPING = "sources/stepping.h"
_FMI3 = "sources/fmi3.c"
_UPDATE = '    return said(update_discrete_states(self, "fmi3UpdateDiscreteStates"));'
_EVENT, _EARLY, _BETWEEN, _SLOPES = "event mode of Co-Simulation", "early return", "intermediate update", "input derivatives"
_TOLD = "    *lastSuccessfulTime = self->model.time;"
_FINISHED = "self->environment, step->begin + offset, fmi3False, fmi3True, fmi3True, self->early_return_allowed != 0, &early, &when);"

# (the defect, the check that must fail, words of its sentence, edits that seed it: (file, old, new), version of FMI).
_DEFECTS = (
    ("events are not announced", _EVENT, "stands still", ((_FMI3, "*eventHandlingNeeded = event != 0;", "*eventHandlingNeeded = fmi3False;"),), "3.0"),
    ("an event changes the motion", _EVENT, "than without",
     (("sources/instance.h", "    if (model_update_modes(&self->model) && ", "    if (model_update_modes(&self->model) && (self->model.v[2] += 0.7) && "),), "3.0"),
    ("events are not handled", _EVENT, "stands still", (("sources/instance.h", "    if (model_update_modes(&self->model) && ", "    if (0 && "),), "3.0"),
    ("an update of events moves something", _EVENT, "called once more it changes values", ((_FMI3, _UPDATE, f"    self->model.v[0] += 1e-9;\n{_UPDATE}"),), "3.0"),
    ("updates are asked for without end", _EVENT, "did not end", ((_FMI3, _UPDATE, f"    *discreteStatesNeedUpdate = fmi3True;\n{_UPDATE}"),), "3.0"),
    ("reset keeps something of a run with event mode", _EVENT, "after reset",
     (("sources/instance.h", "    model_start(&self->model);\n    return change_phase",
       "    const double time = self->model.time;\n"
                "    model_start(&self->model);\n    if (self->event_mode_used && time > 1.0) self->model.q[0] += 1e-9;\n    return change_phase"),), "3.0"),
    ("it returns early unasked", _EARLY, "which was not allowed",
     ((_STEPPING, "quotient, self->early_return_allowed, observer);", "quotient, self->event_mode_used, observer);"),), "3.0"),
    ("the time of an early return is that of the step's end", _EARLY, "the variable time says",
     ((_FMI3, _TOLD, "    *lastSuccessfulTime = currentCommunicationPoint + communicationStepSize;"),), "3.0"),
    ("an early return is not told", _EARLY, "did not return early, and that it reached",
     ((_FMI3, "*earlyReturn = status == STATUS_OK && dt < communicationStepSize;", "*earlyReturn = fmi3False;"),), "3.0"),
    ("a wish to return early is not heard", _EARLY, "was asked at", ((_FMI3, "    if (wanted < *finish) *finish", "    if (0) *finish"),), "3.0"),
    ("intermediate update never comes", _BETWEEN, "never called", ((_FMI3, "self->update ? step_finished : NULL", "NULL"),), "3.0"),
    ("intermediate update tells a time since the step began", _BETWEEN, "it is called for t =", ((_FMI3, _FINISHED, _FINISHED.replace("step->begin + offset", "offset")),), "3.0"),
    ("intermediate update offers what is not allowed", _BETWEEN, "offers an early return",
     ((_FMI3, _FINISHED, _FINISHED.replace("self->early_return_allowed != 0", "fmi3True")),), "3.0"),
    ("values may be got and are refused", _BETWEEN, "that is refused", ((_FMI3, "self->model.phase = PHASE_OUTPUT_UPDATE;", "self->model.phase = PHASE_INPUT_UPDATE;"),), "3.0"),
    ("being watched moves the model", _BETWEEN, "than without",
     ((_FMI3, "    self->model.phase = PHASE_OUTPUT_UPDATE;", "    self->model.u[0] = 9.0;\n    self->model.phase = PHASE_OUTPUT_UPDATE;"),), "3.0"),
    ("slopes are taken and forgotten", _SLOPES, "no slope", ((_STEPPING, "index] = values[i];", "index] = 0.0 * values[i];"),), "2.0"),
    ("slopes are per step, not per second", _SLOPES, "with sloping inputs", ((_STEPPING, "index] = values[i];", "index] = 0.1 * values[i];"),), "2.0"),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("defect", _DEFECTS, ids=lambda defect: defect[0])
def test_defect_of_a_step_is_found(defect: tuple, must_find):
    must_find(*defect)

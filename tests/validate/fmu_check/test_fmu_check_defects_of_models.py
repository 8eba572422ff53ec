"""Each seeded defect of equations, derivatives, events, binary and description is found, and by the check that is there for it."""

import pytest

_XML = "modelDescription.xml"
_EQUATIONS = "sources/equations.h"
_EXCHANGE = "sources/exchange.h"
_INTEGRATOR = "sources/integrator.h"

# (the defect, the check that must fail, words of its sentence, edits that seed it: (file, old, new)), and the version of FMI if not 2.0.
_DEFECTS = (
    ("derivatives of accelerations have the wrong sign", "directional derivatives", "finite differences give",
     ((_EQUATIONS, "case KIND_VELOCITY_RATE: return d->a[i];", "case KIND_VELOCITY_RATE: return -d->a[i];"),)),
    ("one entry is a little more than a thousandth too large, in contact only", "directional derivatives", "d lam_left",
     ((_EQUATIONS, "case KIND_FORCE: return d->lam[i];", "case KIND_FORCE: return i ? d->lam[i] : 1.0012 * d->lam[i];"),)),
    ("derivatives of accelerations are a little more than a thousandth too large", "directional derivatives", "finite differences give",
     ((_EQUATIONS, "case KIND_VELOCITY_RATE: return d->a[i];", "case KIND_VELOCITY_RATE: return 1.0012 * d->a[i];"),)),
    ("the column of the inputs is zero", "directional derivatives", "/ d u1",
     ((_EQUATIONS, "if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, d->u,",
       "double zero[ROOM(NU)] = {0};\n    if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, zero,"),)),
    ("Co-Simulation has another gain by a thousandth", "Model Exchange equals Co-Simulation", "more than steps and tolerances explain",
     ((_INTEGRATOR, "u[i] = inputs->value[i]", "u[i] = 1.001 * inputs->value[i]"),)),
    ("a start value is another one in the XML by a ten-thousandth", "start values are the XML's", "c is 2 in the binary, 2.0002",
     ((_XML, 'unit="N s/m" start="2.0"', 'unit="N s/m" start="2.0002"'),)),
    ("a nominal is another one in the XML by a ten-thousandth", "nominals are the XML's", "state 0 has the nominal 1",
     ((_XML, 'start="2.0" nominal="1.0"', 'start="2.0" nominal="1.0001"'),)),
    ("FMI 3: an adjoint is a ten-thousandth too large", "adjoint derivatives", "the adjoint of",
     ((_EQUATIONS, "case KIND_GAP: bar->phi[i] -= weight; break;", "case KIND_GAP: bar->phi[i] -= 1.0001 * weight; break;"),), "3.0"),
    ("FMI 3: an indicator is not its variable by a ten-thousandth", "event indicators announce events", "event indicator 0",
     ((_EQUATIONS, "indicators[i] = -m->phi[i];", "indicators[i] = -1.0001 * m->phi[i];"),), "3.0"),
    ("a function is not exported", "exported functions", "fmi2GetDirectionalDerivative",
     (("sources/fmi2.c", "fmi2Status fmi2GetDirectionalDerivative(", "fmi2Status unknown_name("),)),
    ("an output depends on more than it says", "dependencies are complete", "input_power changes with v3",
     ((_XML, 'dependencies="5 7 14 15"', 'dependencies="5 14 15"'),
      (_XML, 'dependenciesKind="dependent dependent dependent dependent"/>', 'dependenciesKind="dependent dependent dependent"/>'))),
    ("a factor is not constant", "dependencies are complete", "constant factor",
     ((_XML, '<Unknown index="16" dependencies="2 3" dependenciesKind="dependent dependent"', '<Unknown index="16" dependencies="2 3" dependenciesKind="constant constant"'),)),
    ("an acceleration has the unit of a velocity", "variables are consistent", "der(v1) has the unit m/s", ((_XML, 'unit="m/s^2" derivative="5"', 'unit="m/s" derivative="5"'),)),
    ("a unit is not defined", "description is valid", "furlong", ((_XML, 'unit="m" start="2.0"', 'unit="furlong" start="2.0"'),)),
    ("a start lies outside its range", "variables are consistent", "k starts at -3", ((_XML, 'unit="N/m" start="30.0"', 'unit="N/m" start="-3"'),)),
    ("a value reference does not exist", "variables can be read", "value reference 220",
     ((_XML, 'name="dissipated_power" valueReference="22"', 'name="dissipated_power" valueReference="220"'),)),
    ("two derivatives are swapped in the array", "states and derivatives are the listed ones", "derivative",
     ((_EXCHANGE, "    model_rates(&self->model, rates);\n",
       "    model_rates(&self->model, rates);\n    rates[0] = self->model.v[1];\n    rates[1] = self->model.v[0];\n"),)),
    ("two derivatives are swapped in the XML", "states and derivatives are the listed ones", "state",
     ((_XML, 'derivative="2"', 'derivative="0"'), (_XML, 'derivative="3"', 'derivative="2"'), (_XML, 'derivative="0"', 'derivative="3"'))),
    ("an event indicator never changes its sign", "event indicators announce events", "missing or wrong",
     ((_EQUATIONS, "indicators[i] = -m->phi[i];", "indicators[i] = fabs(m->phi[i]) + 1e-3;"),)),
    ("event indicators are missing", "event indicators announce events", "missing or wrong", ((_XML, 'numberOfEventIndicators="2"', 'numberOfEventIndicators="0"'),)),
    ("an event indicator is a sign", "event indicators announce events", "jumps over zero",
     ((_EQUATIONS, "indicators[i] = -m->phi[i];", "indicators[i] = m->phi[i] > 0.0 ? -1.0 : 1.0;"),)),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("defect", _DEFECTS, ids=lambda defect: defect[0])
def test_defect_is_found(defect: tuple, must_find):
    must_find(*defect)

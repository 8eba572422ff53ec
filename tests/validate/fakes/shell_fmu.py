"""Builds FMUs of other kinds than ours for the tests, from shell.c and a model: events that change states, time events, no states, a fixed solver step."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

from models.codegen.compiler import compile_shared, find_compiler
from models.fmu.description import find_standard, standard_headers

_SHELL = Path(__file__).parents[1] / "fmu_check" / "models" / "shell.c"
SKIP_SLOPE = """
static int slope(const Model *m, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *dk, double *du)
{
    (void)m; (void)u; (void)nu; (void)k; (void)nk; (void)dk; (void)du;
    return 1;
}
"""
NO_EVENTS = """
static void indicate(Model *m, double *z) { (void)m; (void)z; }
static int update(Model *m) { (void)m; return 0; }
static double next_event(const Model *m) { (void)m; return HUGE_VAL; }
"""


@dataclass(frozen=True)
class Foreign:
    """A model for shell.c: macros, C text, (name, reference, attributes, <Real> attributes) of its reals, and more of the description.

    expected, untold: check -> words of its sentence, of those that pass and of those that cannot be
        told.
    """

    name: str
    macros: str
    code: str
    reals: tuple[tuple[str, str, str], ...]
    experiment: str
    states: tuple[int, ...] = ()
    integers: str = ""
    indicators: int = 0
    variable_step: bool = True
    slopes: bool = False
    expected: tuple[tuple[str, str], ...] = ()
    untold: tuple[tuple[str, str], ...] = ()


STATE = 'causality="output" variability="continuous" initial="exact"'
RATE = 'causality="local" variability="continuous" initial="calculated"'
PARAMETER = 'causality="parameter" variability="fixed" initial="exact"'

FOREIGN = (
    Foreign(
        name="bouncing_ball",
        macros="#define NX 2\n#define NZ 1\n#define NR 7\n#define NI 0\n#define SOLVER_STEP 1e-3\n#define STATE(k) (1 + 2 * (k))\n#define RATE(k) (2 + 2 * (k))\n",
        code="""
enum { H = 1, DER_H, V, DER_V, G, E, V_MIN };
static void start(Model *m) { m->r[H] = 1.0; m->r[G] = -9.81; m->r[E] = 0.7; m->r[V_MIN] = 0.1; }
static void calculate(Model *m) { m->r[DER_H] = m->r[V]; m->r[DER_V] = m->r[G]; }
static void indicate(Model *m, double *z) { z[0] = m->r[H]; }
static int update(Model *m)
{
    if (!(m->r[H] <= 0.0 && m->r[V] < 0.0)) return 0;
    m->r[H] = 1e-300;
    m->r[V] *= -m->r[E];
    if (m->r[V] < m->r[V_MIN]) m->r[V] = m->r[G] = 0.0;
    return 1;
}
static double next_event(const Model *m) { (void)m; return HUGE_VAL; }
"""
        + SKIP_SLOPE,
        reals=(
            ("h", STATE, 'start="1"'),
            ("der(h)", RATE, 'derivative="2"'),
            ("v", STATE, 'start="0"'),
            ("der(v)", RATE, 'derivative="4"'),
            ("g", PARAMETER, 'start="-9.81"'),
            ("e", PARAMETER, 'start="0.7" min="0.5" max="1"'),
            ("v_min", PARAMETER, 'start="0.1" min="0"'),
        ),
        states=(2, 4),
        experiment='startTime="0" stopTime="3" stepSize="1e-2"',
        indicators=1,
        expected=(("event indicators announce events", "state events"),),
        # A bounce that comes a little later differs by the whole velocity: such a comparison says
        # nothing.
        untold=(("Model Exchange equals Co-Simulation", "no more than explicit Euler"),),
    ),
    Foreign(
        name="van_der_pol",
        macros="#define NX 2\n#define NZ 0\n#define NR 5\n#define NI 0\n#define SOLVER_STEP 1e-2\n#define STATE(k) (1 + 2 * (k))\n#define RATE(k) (2 + 2 * (k))\n",
        code="""
enum { X0 = 1, DER_X0, X1, DER_X1, MU };
static void start(Model *m) { m->r[X0] = 2.0; m->r[MU] = 1.0; }
static void calculate(Model *m) { m->r[DER_X0] = m->r[X1]; m->r[DER_X1] = m->r[MU] * (1.0 - m->r[X0] * m->r[X0]) * m->r[X1] - m->r[X0]; }
static int slope(const Model *m, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *dk, double *du)
{
    double d[NR + 1] = {0};
    for (size_t i = 0; i < nk; i++) d[k[i]] += dk[i];
    d[DER_X0] = d[X1];
    d[DER_X1] = d[MU] * (1.0 - m->r[X0] * m->r[X0]) * m->r[X1] - 2.0 * m->r[MU] * m->r[X0] * d[X0] * m->r[X1]
        + m->r[MU] * (1.0 - m->r[X0] * m->r[X0]) * d[X1] - d[X0];
    for (size_t i = 0; i < nu; i++) du[i] = d[u[i]];
    return 0;
}
"""
        + NO_EVENTS,
        reals=(
            ("x0", STATE, 'start="2"'),
            ("der(x0)", RATE, 'derivative="2"'),
            ("x1", STATE, 'start="0"'),
            ("der(x1)", RATE, 'derivative="4"'),
            ("mu", PARAMETER, 'start="1"'),
        ),
        states=(2, 4),
        experiment='startTime="0" stopTime="20" stepSize="1e-2"',
        slopes=True,
        expected=(
            ("directional derivatives", "entries at"),
            ("Model Exchange equals Co-Simulation", "no more than explicit Euler"),
        ),
    ),
    Foreign(
        name="stair",
        macros="#define NX 0\n#define NZ 0\n#define NR 0\n#define NI 1\n#define SOLVER_STEP 0.2\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 1)\n",
        code="""
static void start(Model *m) { m->i[0] = 1; }
static void calculate(Model *m) { (void)m; }
static void indicate(Model *m, double *z) { (void)m; (void)z; }
static double next_event(const Model *m) { return m->start + m->i[0]; }
static int update(Model *m)
{
    while (m->time >= next_event(m) - 1e-9) m->i[0]++;
    return 0;
}
"""
        + SKIP_SLOPE,
        reals=(),
        integers='<ScalarVariable name="counter" valueReference="100" causality="output" variability="discrete" initial="exact"><Integer start="1"/></ScalarVariable>',
        experiment='startTime="0" stopTime="10" stepSize="0.2"',
        expected=(("runs repeat", "equal bits"),),
    ),
    Foreign(
        name="dahlquist",
        macros="#define NX 1\n#define NZ 0\n#define NR 3\n#define NI 0\n#define SOLVER_STEP 0.1\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n",
        code="""
static void start(Model *m) { m->r[1] = 1.0; m->r[3] = 1.0; }
static void calculate(Model *m) { m->r[2] = -m->r[3] * m->r[1]; }
"""
        + NO_EVENTS
        + SKIP_SLOPE,
        reals=(
            ("x", STATE, 'start="1"'),
            ("der(x)", RATE, 'derivative="2"'),
            ("k", PARAMETER, 'start="1"'),
        ),
        states=(2,),
        experiment='startTime="0" stopTime="10" stepSize="0.1"',
        variable_step=False,
        expected=(("Model Exchange equals Co-Simulation", "no more than explicit Euler"),),
    ),
)


def _description(model: Foreign) -> str:
    reals = "".join(
        f'<ScalarVariable name="{name}" valueReference="{place}" {attributes}><Real {real}/></ScalarVariable>'
        for place, (name, attributes, real) in enumerate(model.reals, start=1)
    )
    outputs = [place + 1 for place in model.states] and model.states
    listed = outputs or (2,)
    can = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"' + (
        ' providesDirectionalDerivative="true"' if model.slopes else ""
    )
    rates = "".join(f'<Unknown index="{place + 1}"/>' for place in model.states)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{model.name}" guid="{{{model.name}}}" numberOfEventIndicators="{model.indicators}">
<ModelExchange modelIdentifier="{model.name}" {can}/>
<CoSimulation modelIdentifier="{model.name}" canHandleVariableCommunicationStepSize="{str(model.variable_step).lower()}" {can}/>
<DefaultExperiment {model.experiment}/>
<ModelVariables>
<ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous"><Real/></ScalarVariable>
{reals}{model.integers}
</ModelVariables>
<ModelStructure>
<Outputs>{"".join(f'<Unknown index="{place}"/>' for place in listed)}</Outputs>
{f"<Derivatives>{rates}</Derivatives><InitialUnknowns>{rates}</InitialUnknowns>" if rates else ""}
</ModelStructure>
</fmiModelDescription>
"""


def build_shell(model: Foreign, folder: Path, *edits: tuple[str, str]) -> Path:
    """The model's FMU in a folder.

    Compiled there. edits: texts of shell.c, and what stands there instead.
    """
    shell = _SHELL.read_text(encoding="utf-8")
    for old, new in edits:
        assert old in shell
        shell = shell.replace(old, new, 1)
    shell = f'#define IDENTIFIER "{model.name}"\n{model.macros}{shell}'
    sources = {"shell.c": shell, "model.h": model.code, **standard_headers(find_standard("2.0"))}
    library = folder / f"{model.name}.so"
    compile_shared(find_compiler(), sources, library)
    path = folder / f"{model.name}.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _description(model))
        archive.write(library, f"binaries/linux64/{model.name}.so")
    return path

"""Building the kernel: every scene compiles without a warning, text is reproducible, kept for equal equations and made anew for anything else, and what can go wrong is said in words."""

import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen import text_cache
from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler
from models.codegen.emit import emit_model, model_source
from models.codegen.kernel import load_kernel
from models.codegen.text_cache import cached_text
from models.errors import MachineError
from models.fmu.sensitivity import emit_sensitivity, sensitivity_source
from models.scene import Scene

ROOT = Path(__file__).parents[3]
SCENES = ROOT / "tests" / "scenes"
REFERENCES = (
    "three_cart",
    "two_body_collision",
    "bouncing_mass",
    *(str(SCENES / f"{name}.py") for name in ("two_link_arm", "oscillator")),
)
ROLLOUT = (ROOT / "models" / "codegen" / "rollout.c").read_text(encoding="utf-8")


def _python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    full = {**os.environ, **environment}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=full,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("reference", REFERENCES)
def test_every_scene_compiles_without_a_warning(reference: str, tmp_path: Path):
    """Without inputs, without contacts, without parameters, with a mass matrix that must be factorised."""
    assert {"-Wall", "-Wextra", "-Werror"} <= set(FLAGS)
    sources = {"scene_model.h": emit_model(load_scene(reference)), "rollout.c": ROLLOUT}
    compile_shared(
        find_compiler(), sources, tmp_path / "kernel.so", extra_flags=("-pedantic", "-Wshadow")
    )
    assert (tmp_path / "kernel.so").stat().st_size > 0


@pytest.mark.slow
def test_equal_scenes_give_equal_bytes_in_any_process():
    """Another process has other hashes, and sets in another order."""
    here = "".join(emit_model(load_scene(reference)) for reference in REFERENCES)
    code = "from models.catalog import load_scene; from models.codegen.emit import emit_model\n"
    code += f"for reference in {REFERENCES!r}: print(emit_model(load_scene(reference)), end='')"
    done = _python(code, PYTHONHASHSEED="1")
    assert done.stdout == here, done.stderr


def test_parameter_values_need_no_new_kernel():
    scene = load_scene("three_cart")
    soft, stiff = load_kernel(scene), load_kernel(scene.with_parameters(k=300.0))
    assert soft.path == stiff.path
    assert stiff.stiffness() == pytest.approx(10.0 * soft.stiffness())


def test_empty_scene_has_empty_arrays():
    kernel = load_kernel(load_scene(str(SCENES / "oscillator.py")))
    plan = kernel.rollout(np.array([1.0, 0.0]), np.zeros((5, 0)), 0.01)
    assert plan.lam.shape == (5, 0)
    assert kernel.penetration(plan.q).shape == (6, 0)
    u_bar, start_bar = kernel.adjoint(plan, np.zeros((5, 0)), np.ones((6, 1)), np.ones((6, 1)))
    assert u_bar.shape == (5, 0)
    assert np.isfinite(start_bar).all()


_LOAD = """
import sys, importlib.util
if {hide}:
    find = importlib.util.find_spec
    importlib.util.find_spec = lambda name, *rest: None if name == "ziglang" else find(name, *rest)
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import TouchstoneError
try:
    kernel = load_kernel(load_scene("three_cart"))
except TouchstoneError as error:
    print(error)
    sys.exit(error.exit_code)
print(kernel.stiffness()[0])
"""


@pytest.mark.slow
def test_no_compiler_is_said_with_the_way_to_get_one():
    done = _python(_LOAD.format(hide=True), PATH="", CC="")
    assert done.returncode == 3, done.stderr
    assert "no C compiler was found" in done.stdout
    assert "pip install" in done.stdout


@pytest.mark.slow
def test_wrong_cc_is_named():
    done = _python(_LOAD.format(hide=True), CC="no-such-compiler -O9")
    assert done.returncode == 3, done.stderr
    assert "CC is 'no-such-compiler -O9', which does not run" in done.stdout
    done = _python(_LOAD.format(hide=True), CC='"')
    assert "which no shell reads (No closing quotation)" in done.stdout


@pytest.mark.slow
def test_a_command_that_is_no_compiler_is_named(tmp_path: Path):
    """It answers to --version and does nothing else."""
    fake = tmp_path / "fake"
    fake.write_text("#!/bin/sh\necho fake compiler 1.0\n")
    fake.chmod(0o755)
    done = _python(_LOAD.format(hide=True), CC=str(fake), TOUCHSTONE_CACHE=str(tmp_path / "cache"))
    assert done.returncode == 3, done.stderr
    assert "fake compiler 1.0" in done.stdout
    assert "without writing a library" in done.stdout


def test_refused_code_shows_the_compilers_words(tmp_path: Path):
    with pytest.raises(MachineError, match=r"refused the generated code of broken\.c"):
        compile_shared(
            find_compiler(), {"broken.c": "int broken( { return 0; }"}, tmp_path / "broken.so"
        )


def test_compiler_message_shows_the_error_first(tmp_path: Path):
    """The lines before it say in which file and function it is."""
    sources = {"far.h": "static int f(void) { return MISSING; }", "near.c": '#include "far.h"\n'}
    with pytest.raises(MachineError, match=r"near\.c: far\.h:1:\d+: error: .*MISSING"):
        compile_shared(find_compiler(), sources, tmp_path / "near.so")


def test_cache_that_cannot_be_a_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(blocker))
    with pytest.raises(MachineError, match="set TOUCHSTONE_CACHE to a folder you can write"):
        cached("key", ".txt", lambda path: path.write_text("x") and None)


def test_a_failed_build_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))

    def fail(path: Path) -> None:
        path.write_text("half")
        raise MachineError("on purpose")

    with pytest.raises(MachineError, match="on purpose"):
        cached("key", ".txt", fail)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_two_processes_may_build_at_once(tmp_path: Path):
    environment = {**os.environ, "TOUCHSTONE_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", _LOAD.format(hide=False)]
    running = [
        subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    outputs = [process.communicate()[0].strip() for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert outputs == ["30.0", "30.0"]
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".h", ".so"]


def test_next_build_removes_folders_of_dead_builders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    host = socket.gethostname()
    dead, living, elsewhere = (
        f"building-{2**22 + 1}-{host}-x",
        f"building-{os.getpid()}-{host}-x",
        f"building-{2**22 + 1}-another-machine-x",
    )
    for name in (dead, living, elsewhere):
        (tmp_path / name).mkdir()
        (tmp_path / name / "half.so").write_text("half")
    made = cached("key", ".txt", lambda path: path.write_text("whole") and None)
    assert {path.name for path in tmp_path.iterdir()} == {living, elsewhere, made.name}


def test_a_killed_build_leaves_nothing_but_its_own_folder(tmp_path: Path):
    """The compiler's scratch files lie below it, so that they go with it."""
    script = (
        "import os, signal; from pathlib import Path; from models.codegen import compiler\n"
        "from models.codegen.cache import cached\n"
        "compiler.subprocess.run = lambda *asked, **more: os.kill(os.getpid(), signal.SIGKILL)\n"
        "cc = compiler.Compiler(('cc',), 'cc')\n"
        "cached('key', '.so', lambda path: compiler.compile_shared(cc, {'a.c': 'int a;'}, path))\n"
    )
    temporary, cache = tmp_path / "tmp", tmp_path / "cache"
    temporary.mkdir()
    done = _python(script, TMPDIR=str(temporary), TOUCHSTONE_CACHE=str(cache))
    assert done.returncode == -signal.SIGKILL
    assert list(temporary.iterdir()) == []
    (left,) = cache.iterdir()
    assert left.name.startswith("building-")
    assert list(left.rglob("*.c"))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["three_cart", "transport", "cart_pole_walls", "damped_collision", "bouncing_mass"]
)
def test_cached_text_equals_emitted_text(name: str, own_cache):
    scene = load_scene(name)
    for source, emit in ((model_source, emit_model), (sensitivity_source, emit_sensitivity)):
        anew = emit(scene)
        assert source(scene) == anew
        assert source(scene) == anew, "read back"


def asked(scene: Scene) -> bool:
    """Whether the text had to be made."""
    made = []
    cached_text(scene, "probe", lambda: made.append(1) or "text")
    return bool(made)


def test_equal_equations_are_written_once(own_cache):
    scene = load_scene("three_cart")
    assert asked(scene)
    assert not asked(scene)
    assert not asked(scene.with_parameters(k=77.0)), "values are no part of the equations"
    assert not asked(scene.with_task(steps=7)), "nor is the task"


@pytest.mark.parametrize("change", [
    lambda scene: replace(scene,
                          potential_energy=scene.potential_energy + sp.Symbol("q1", real=True)),
    lambda scene: replace(scene, forces=(-scene.forces[0], *scene.forces[1:])),
    lambda scene: replace(scene, contacts=scene.contacts[::-1]),
    lambda scene: replace(scene,
                          contacts=(replace(scene.contacts[0], nominal=0.5), *scene.contacts[1:])),
    lambda scene: scene.with_task(running_cost=2 * scene.task.running_cost),
    lambda scene: replace(scene, name="other"),
])  # fmt: skip
def test_other_equations_are_written_anew(change, own_cache):
    scene = load_scene("three_cart")
    asked(scene)
    assert asked(change(scene))


def test_every_pattern_of_generators_finds_files():
    for pattern in (*text_cache._GENERATORS, *text_cache._ALL):
        assert list(text_cache._MODELS.glob(pattern)), pattern


def test_other_generators_write_anew(monkeypatch, own_cache):
    scene = load_scene("three_cart")
    asked(scene)
    monkeypatch.setattr(text_cache, "_generators", lambda: "another version of the code")
    assert asked(scene)


def test_scene_confusable_names_compile(tmp_path: Path):
    """Coordinates x and bar_x; a contact friction_rail, and a friction rail."""
    text = (SCENES / "drawer.py").read_text(encoding="utf-8")
    for old, new in (
        ('symbols("x f"', 'symbols("x bar_x"'),
        ('name="tip"', 'name="friction_rail"'),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "drawer.py").write_text(text, encoding="utf-8")
    scene = load_scene(str(tmp_path / "drawer.py"))
    sources = {
        "scene_model.h": emit_model(scene),
        "scene_sensitivity.h": emit_sensitivity(scene),
        "friction.h": (ROOT / "models" / "codegen" / "friction.h").read_text(encoding="utf-8"),
        "rollout.c": f'{ROLLOUT}\n#include "scene_sensitivity.h"\n',
    }
    compile_shared(find_compiler(), sources, tmp_path / "kernel.so")
    assert (tmp_path / "kernel.so").stat().st_size > 0

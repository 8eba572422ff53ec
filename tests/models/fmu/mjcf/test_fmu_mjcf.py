"""Robots of MuJoCo as FMUs: the motion is mj_step's to the bit, outputs and parameters are what closed forms say, and reading changes nothing."""

import importlib.util
import math
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from robots import LEG, H

from models.fmu.mjcf import build_robot, read_robot
from validate.fmi.description import FmuError, read_package, unpacked
from validate.fmi.instance import References, load_instance

mujoco = pytest.importorskip("mujoco")

VERSIONS = ("2.0", "3.0")
# A block that lies, or slides along x, on a floor.
BLOCK = """
<mujoco>
  <option timestep="0.001" cone="elliptic" impratio="100" iterations="200" tolerance="1e-14"/>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 .1" friction=".5"/>
    <body name="block" pos="0 0 .1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom name="block" type="box" size=".2 .2 .1" mass="3" friction=".5"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
</mujoco>
"""
PENDULUM = """
<mujoco>
  <option gravity="0 0 -9.81" timestep="0.01"/>
  <worldbody>
    <body><joint name="swing" axis="0 1 0"/><inertial pos="0 0 -.7" mass="1.3" diaginertia="1e-9 1e-9 1e-9"/></body>
    <body pos="3 0 0" name="top"><joint name="ball" type="ball"/><geom type="box" size=".3 .2 .1" contype="0" conaffinity="0"/></body>
  </worldbody>
</mujoco>
"""


class Slave:
    """An instance by names of variables."""

    def __init__(self, package, kind: str) -> None:
        self.references = {
            variable.name: int(variable.valueReference)
            for variable in package.description.modelVariables
        }
        self.fmu = load_instance(package, kind)
        self.time = 0.0

    def of(self, names: Sequence[str]) -> References:
        return References([self.references[name] for name in names])

    def begin(self, start: float = 0.0, **settings: float) -> "Slave":
        self.time = start
        self.fmu.initialise(
            start,
            [(self.references[name], value) for name, value in settings.items()],
            References([]),
            np.zeros(0),
        )
        return self

    def get(self, *names: str) -> np.ndarray:
        return self.fmu.read(self.of(names)).copy()

    def set(self, **values: float) -> None:
        self.fmu.write(self.of(list(values)), list(values.values()))

    def step(self, length: float, count: int = 1) -> None:
        for _ in range(count):
            self.fmu.do_step(self.time, length)
            self.time += length


@contextmanager
def instance(robot, kind: str = "CS", version: str = "2.0", **settings: float):
    """One that has begun with these settings."""
    with unpacked(read_package(build_robot(robot, version))) as package:
        slave = Slave(package, kind)
        try:
            yield slave.begin(**settings)
        finally:
            slave.fmu.unload()


def states_of(robot) -> list[str]:
    return [
        variable.name for variable in robot.table if variable.kind.name in ("POSITION", "VELOCITY")
    ]


def state_of(data) -> np.ndarray:
    return np.concatenate([data.qpos, data.qvel, data.act])


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_the_motion_is_that_of_mj_step_to_the_bit(robot, version: str):
    leg = robot(LEG, "foot:floor")
    data, rng, touched = mujoco.MjData(leg.model), np.random.default_rng(0), 0
    with instance(leg, version=version) as fmu:
        for step in range(1000):
            u = rng.uniform([-8.0, -1.0], [8.0, 1.0])
            calls = 1 + step % 3
            data.ctrl[:] = u
            for _ in range(calls):
                mujoco.mj_step(leg.model, data)
                touched += data.ncon > 0
            fmu.set(u_hip=u[0], u_knee=u[1])
            fmu.step(calls * H)
            assert fmu.get(*states_of(leg)).tolist() == state_of(data).tolist()
            if step % 7 == 0:  # what is read between steps changes nothing
                fmu.get("s_imu_0", "lam_foot_floor", "gap_foot_floor", "der(v_knee)")
    assert touched > 300


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "own"), [(2.5 * H, 2.5 * H / 3), (0.4 * H, 0.4 * H), (H * (1 + 1e-12), H)]
)
def test_equal_steps_no_longer_than_the_model_s_divide_a_communication_step(
    robot, length: float, own: float
):
    leg = robot(LEG)
    leg.model.opt.timestep = own
    data = mujoco.MjData(leg.model)
    with instance(robot(LEG)) as fmu:
        fmu.step(length, 20)
        mujoco.mj_step(leg.model, data, 20 * round(length / own))
        assert fmu.get(*states_of(leg)).tolist() == state_of(data).tolist()


@pytest.mark.slow
def test_a_robot_starts_at_its_keyframe(robot):
    leg = robot(LEG, keyframe="bent")
    data = mujoco.MjData(leg.model)
    mujoco.mj_resetDataKeyframe(leg.model, data, 0)
    with instance(leg) as fmu:
        assert fmu.get("q_root_z", "q_hip", "q_knee", "act_knee", "u_hip", "u_knee").tolist() == [
            0.5,
            0.4,
            -0.8,
            -0.8,
            1.0,
            -0.8,
        ]
        fmu.step(H, 100)
        mujoco.mj_step(leg.model, data, 100)
        assert fmu.get(*states_of(leg)).tolist() == state_of(data).tolist()


@pytest.mark.slow
def test_outputs_are_those_of_the_state_that_is_reached(robot):
    leg = robot(LEG, "foot:floor", "trunk:floor")
    data = mujoco.MjData(leg.model)
    with instance(leg) as fmu:
        fmu.step(H, 300)
        mujoco.mj_step(leg.model, data, 300)
        leg.model.opt.tolerance = 1e-14  # what is read is not left where a step may stop
        mujoco.mj_forward(leg.model, data)  # mj_step leaves what belongs to the step's beginning
        assert (
            fmu.get("s_hip_angle", "s_imu_0", "s_imu_1", "s_imu_2", "s_trunk").tolist()
            == data.sensordata.tolist()
        )
        assert fmu.get("der(v_hip)").tolist() == data.qacc[6:7].tolist()
        hull, floor = (leg.model.geom(name).id for name in ("hull", "floor"))
        assert fmu.get("gap_trunk_floor") == pytest.approx(
            mujoco.mj_geomDistance(leg.model, data, hull, floor, 10.0, None), abs=1e-12
        )


@pytest.mark.slow
@pytest.mark.parametrize("mass", [3.0, 0.5])
def test_a_block_that_lies_presses_with_its_weight(robot, mass: float):
    block = robot(BLOCK, "block:floor")
    with instance(block, mass_block=mass) as fmu:
        fmu.step(0.001, 3000)
        force, gap, height = fmu.get("lam_block_floor", "gap_block_floor", "q_z")
        assert force == pytest.approx(mass * 9.81, rel=1e-6)
        assert -1e-2 < gap == pytest.approx(height, abs=1e-12)
        assert gap < 0.0


@pytest.mark.slow
def test_rates_are_those_of_ever_smaller_steps_and_forces_those_of_the_steps(robot):
    """A time constant of 2 ms is cut at twice a step of 5 ms: by such steps a block comes to rest deeper than its own spring would let it lie."""
    made = robot(
        BLOCK.replace('timestep="0.001"', 'timestep="0.005"').replace(
            "<geom", '<geom solref=".002 1"'
        ),
        "block:floor",
    )
    with instance(made) as fmu:
        fmu.step(0.005, 2000)
        force, rate, depth = fmu.get("lam_block_floor", "der(v_z)", "q_z")
        assert force == pytest.approx(3.0 * 9.81, rel=1e-6)
        before = fmu.get("v_z")[0]
        fmu.step(1e-7)
        assert (fmu.get("v_z")[0] - before) / 1e-7 == pytest.approx(rate, rel=1e-3)
        assert rate > 5.0
        assert depth < 0.0


@pytest.mark.slow
def test_without_gravity_nothing_presses(robot):
    with instance(robot(BLOCK, "block:floor"), gravity_z=0.0, q_z=0.25) as fmu:
        fmu.step(0.001, 100)
        assert fmu.get("lam_block_floor", "gap_block_floor", "q_z") == pytest.approx(
            [0.0, 0.25, 0.25], abs=1e-15
        )


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.4, 0.0])
def test_a_block_that_slides_is_slowed_by_its_friction(robot, scale: float):
    """By mu g, as long as it slides: 2 m/s lose 0.98 m/s in 0.2 s.

    MuJoCo's smallest coefficient is 1e-5.
    """
    with instance(robot(BLOCK), v_x=2.0, friction_scale=scale, q_z=-1e-4) as fmu:
        fmu.step(0.001, 200)
        with pytest.raises(FMICallException):
            fmu.set(v_x=2.0)  # a state is set at the start alone
        assert fmu.get("v_x")[0] == pytest.approx(
            2.0 - max(scale * 0.5, 1e-5) * 9.81 * 0.2, abs=2e-2 * scale + 1e-8
        )


@pytest.mark.slow
def test_a_stiffer_contact_gives_less_and_a_harder_one_too(robot):
    """The depth at rest goes as 1 / stiffness.

    A constraint that gives way by half as much lets a heavy block in by less.
    """

    def depth(**parameters: float) -> float:
        with instance(robot(BLOCK, "block:floor"), timestep=1e-4, **parameters) as fmu:
            fmu.step(0.01, 150)
            return -fmu.get("gap_block_floor")[0]

    own = depth()
    assert depth(contact_stiffness_scale=4.0) == pytest.approx(own / 4.0, rel=0.05)
    assert 0.2 * own < depth(contact_give_scale=0.5) < 0.9 * own


@pytest.mark.slow
def test_parameters_may_change_between_steps_and_back(robot):
    leg = robot(LEG)
    with instance(leg) as fmu:
        fmu.step(H, 10)
        saved = fmu.fmu.save()
        fmu.step(H, 10)
        plain, after = fmu.get(*states_of(leg)), fmu.time
        fmu.fmu.restore(saved)
        fmu.time = after - 10 * H
        fmu.set(mass_trunk=9.0, gravity_x=1.0, contact_stiffness_scale=2.0, timestep=H / 2)
        fmu.set(mass_trunk=2.0, gravity_x=0.0, contact_stiffness_scale=1.0, timestep=H)
        fmu.step(H, 10)
        assert fmu.get(*states_of(leg)).tolist() == plain.tolist()
        fmu.fmu.restore(saved)
        fmu.time = after - 10 * H
        fmu.set(gravity_x=1.0)
        fmu.step(H, 10)
        assert fmu.get("v_root_x")[0] - plain[states_of(leg).index("v_root_x")] == pytest.approx(
            10 * H, rel=0.2
        )
        fmu.fmu.forget(saved)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_is_the_equations_of_motion(robot, version: str):
    """A point at the end of a rod: dw/dt = -g/l sin(angle); a quaternion turns as q (0, w) / 2."""
    pendulum = robot(PENDULUM)
    q, w = (
        np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7]),
        np.array([0.3, -2.0, 1.1]),
    )
    names = dict(zip(("q_ball_qw", "q_ball_qx", "q_ball_qy", "q_ball_qz"), q, strict=True))
    turning = dict(zip(("v_ball_wx", "v_ball_wy", "v_ball_wz"), w, strict=True))
    with instance(pendulum, "ME", version, q_swing=0.8, v_swing=-0.4, **turning, **names) as fmu:
        fmu.fmu.settle()
        assert fmu.get("der(q_swing)", "der(v_swing)") == pytest.approx(
            [-0.4, -9.81 / 0.7 * math.sin(0.8)], rel=1e-6
        )
        moved = fmu.get("q_swing", *names)
        mujoco.mj_integratePos(pendulum.model, moved, np.array([-0.4, *w]), 1e-6)
        assert fmu.get(*(f"der({name})" for name in names)) == pytest.approx(
            (moved[1:] - q) / 1e-6, abs=1e-5
        )
        scalar, vector = -(q[1:] @ w) / 2, (q[0] * w + np.cross(q[1:], w)) / 2
        assert fmu.get(*(f"der({name})" for name in names)) == pytest.approx(
            [scalar, *vector], rel=1e-14
        )


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_directional_derivatives_are_those_of_the_equations(robot, version: str):
    """Of d w/dt = -g/l sin(angle) by the angle, and of dq/dt = q (0, w) / 2 by w and by q."""
    turned = {
        "v_ball_wx": 0.3,
        "v_ball_wy": -2.0,
        "v_ball_wz": 1.1,
        "q_ball_qw": 0.5,
        "q_ball_qx": -0.5,
        "q_ball_qy": 0.5,
        "q_ball_qz": 0.5,
    }
    with instance(robot(PENDULUM), "ME", version, q_swing=0.8, **turned) as fmu:
        fmu.fmu.settle()

        def slopes(unknowns: Sequence[str], **seed: float) -> list[float]:
            places = [[fmu.references[name] for name in names] for names in (unknowns, list(seed))]
            return list(
                fmu.fmu.fmu.directional(places[0], places[1], list(seed.values()), len(unknowns))
            )

        (found,) = slopes(["der(v_swing)"], q_swing=1.0)
        assert found == pytest.approx(-9.81 / 0.7 * math.cos(0.8), rel=1e-7)
        assert slopes(
            ["der(q_swing)", "q_swing", "v_swing"], q_swing=2.0, v_swing=-3.0
        ) == pytest.approx([-3.0, 2.0, -3.0], rel=1e-9)
        rates = [f"der(q_ball_{part})" for part in ("qw", "qx", "qy", "qz")]
        assert slopes(rates, v_ball_wx=1.0) == pytest.approx([0.25, 0.25, 0.25, -0.25], abs=1e-9)
        assert slopes(rates, q_ball_qw=1.0) == pytest.approx([0.0, 0.15, -1.0, 0.55], abs=1e-9)
        with pytest.raises(FMICallException):
            slopes(["der(v_swing)"], mass_top=1.0)
        assert fmu.get("der(q_swing)").tolist() == [0.0]  # nothing moved


@pytest.mark.slow
def test_a_slope_is_there_where_a_step_s_solver_would_stop_before_it(robot):
    """An ellipsoid on a smooth floor, turned by t about y: where it touches moves by -(a^2 - c^2)/c t along x, at which its weight's answer turns it."""
    puck = "<mujoco><default><geom condim='1'/></default><worldbody><geom name='floor' type='plane' size='5 5 .1'/><body pos='0 0 .0957'><freejoint name='puck'/>"
    puck += (
        "<geom name='puck' type='ellipsoid' size='.2 .1 .1' mass='1'/></body></worldbody></mujoco>"
    )
    made = robot(puck, "puck:floor")
    with instance(made, "ME") as fmu:
        fmu.fmu.settle()
        names = ["der(v_puck_wy)", "q_puck_qy"]
        (slope,) = fmu.fmu.fmu.directional(
            [fmu.references[names[0]]], [fmu.references[names[1]]], [2.0**-1], 1
        )
        force, inertia = fmu.get("lam_puck_floor")[0], 1.0 * (0.2**2 + 0.1**2) / 5.0
        assert slope == pytest.approx(-force * (0.2**2 - 0.1**2) / 0.1 / inertia, rel=1e-4)


def _slope(fmu: Slave, unknown: str, known: str) -> float:
    (slope,) = fmu.fmu.fmu.directional([fmu.references[unknown]], [fmu.references[known]], [1.0], 1)
    return slope


@pytest.mark.slow
@pytest.mark.parametrize("gap", [3e-6, -3e-6, 3e-8, -3e-8, 0.01])
def test_slope_beside_a_contact_that_opens_is_of_its_own_side(robot, gap: float):
    """A ball that is nearer to a smooth floor than the differences are long: free fall knows no height, and the floor answers it."""
    ball = "<mujoco><default><geom condim='1'/></default><worldbody><geom name='floor' type='plane' size='5 5 .1'/>"
    ball += "<body><joint name='z' type='slide' axis='0 0 1'/><geom name='ball' size='.1' mass='1'/></body></worldbody></mujoco>"
    made = robot(ball)

    def acceleration(height: float, speed: float = -0.3) -> float:
        data = mujoco.MjData(made.model)
        data.qpos[0], data.qvel[0] = height, speed
        mujoco.mj_forward(made.model, data)
        return data.qacc[0]

    # One-sided, away from the floor's surface, as MuJoCo has no slope of its own there.
    away = 1e-6 if gap > 0.0 else -1e-6
    height = 0.1 + gap
    expected = (
        -3.0 * acceleration(height)
        + 4.0 * acceleration(height + away)
        - acceleration(height + 2.0 * away)
    ) / (2.0 * away)
    with instance(made, "ME", q_z=height, v_z=-0.3) as fmu:
        fmu.fmu.settle()
        assert fmu.get("der(v_z)")[0] == pytest.approx(acceleration(height), rel=1e-9)
        slope = _slope(fmu, "der(v_z)", "q_z")
    assert slope == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert (abs(slope) > 100.0) == (gap < 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("off", "slope"), [(2e-6, -400.0), (-2e-6, 0.0)])
def test_slope_beside_the_end_of_a_dead_band_is_of_its_own_side(robot, off: float, slope: float):
    """A tendon of 400 N/m that is slack up to 0.5 m."""
    mass = "<mujoco><option gravity='0 0 0'/><worldbody><body><joint name='x' type='slide' axis='1 0 0'/><geom size='.1' mass='1' condim='1'/></body></worldbody>"
    mass += "<tendon><fixed stiffness='400' springlength='-1 .5'><joint joint='x' coef='1'/></fixed></tendon></mujoco>"
    with instance(robot(mass), "ME", q_x=0.5 + off) as fmu:
        fmu.fmu.settle()
        assert _slope(fmu, "der(v_x)", "q_x") == pytest.approx(slope, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("control", "slope"), [(1.0, 5.0), (-1.0, 5.0), (1.0 + 1e-6, 0.0)])
def test_slope_by_a_control_at_its_bound_is_of_the_side_within(robot, control: float, slope: float):
    mass = "<mujoco><option gravity='0 0 0'/><worldbody><body><joint name='x' type='slide' axis='1 0 0'/><geom size='.1' mass='1' condim='1'/></body></worldbody>"
    mass += "<actuator><motor name='push' joint='x' gear='5' ctrlrange='-1 1'/></actuator></mujoco>"
    with instance(robot(mass), "ME") as fmu:
        fmu.fmu.settle()
        fmu.set(u_push=control)
        assert _slope(fmu, "der(v_x)", "u_push") == pytest.approx(slope, abs=1e-6)


@pytest.mark.slow
def test_a_motion_that_breaks_down_ends_in_a_sentence_at_the_last_good_step(robot):
    leg = robot(LEG)
    with instance(leg) as fmu:
        fmu.step(H, 5)
        before = fmu.get(*states_of(leg))
        fmu.set(u_hip=8.0, mass_trunk=1e-12, gravity_z=-1e14)
        with pytest.raises(FMICallException):
            fmu.step(H, 50)
        assert "infinite" in fmu.fmu.quote()
        assert "timestep" in fmu.fmu.quote()
        assert np.isfinite(fmu.get(*states_of(leg))).all()
        assert fmu.get("time")[0] < 55 * H
        fmu.fmu.fmu.reset()
        fmu.begin()
        fmu.step(H, 5)
        assert fmu.get(*states_of(leg)).tolist() == before.tolist()


@pytest.mark.slow
def test_equal_robots_give_equal_bytes(robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    bytes_of = []
    for number in range(2):
        monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path / str(number)))
        bytes_of.append(
            build_robot(read_robot(robot(LEG).path.rename(tmp_path / "leg.xml"))).read_bytes()
        )
    assert bytes_of[0] == bytes_of[1]


@pytest.mark.slow
def test_a_damaged_fmu_is_refused_when_it_is_instantiated(robot):
    with unpacked(read_package(build_robot(robot(LEG)))) as package:
        model = Path(str(package.folder)) / "resources" / "model.mjb"
        model.write_bytes(model.read_bytes()[:2000])
        with pytest.raises(FmuError, match=r"model\.mjb cannot be loaded.*damaged.*[Tt]runcated"):
            load_instance(package, "CS")
        model.unlink()
        with pytest.raises(FmuError, match=r"model\.mjb cannot be loaded"):
            load_instance(package, "CS")


@pytest.mark.slow
def test_the_library_travels_with_its_licenses(robot):
    with unpacked(read_package(build_robot(robot(LEG)))) as package:
        assert list(Path(str(package.folder)).glob("binaries/*/libmujoco.so.*"))
    import zipfile

    with zipfile.ZipFile(build_robot(robot(LEG))) as archive:
        assert b"Apache License" in archive.read("documentation/licenses/mujoco/LICENSE")
        assert mujoco.__version__ in archive.read("documentation/licenses/license.txt").decode()
        assert str(Path.cwd()).encode() not in b"".join(
            archive.read(name) for name in archive.namelist()
        )


def _three_cart() -> str:
    """The scene as bodies on slides.

    A contact is a spring between two of them with a dead band, k max(d - distance, 0).
    """
    carts = "".join(
        f'<body><joint name="q{number}" type="slide" axis="1 0 0" damping="2"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
        for number in (1, 2, 3)
    )
    springs = "".join(
        f'<fixed stiffness="30" springlength="0.5 1e6"><joint joint="q{right}" coef="1"/><joint joint="q{left}" coef="-1"/></fixed>'
        for left, right in ((1, 2), (2, 3))
    )
    motors = "".join(
        f'<motor name="{number}" joint="q{number}" ctrlrange="-10 10"/>' for number in (1, 3)
    )
    return (
        f'<mujoco><option integrator="RK4" gravity="0 0 0" timestep="0.01"/><worldbody>{carts}</worldbody><tendon>{springs}</tendon>'
        f"<actuator>{motors}</actuator></mujoco>"
    )


@pytest.mark.slow
def test_three_carts_agree_with_the_scene_s_own_fmu_to_the_order_of_the_engine(robot):
    """Runge-Kutta 4 over contacts that it does not locate: the force bends there, so it is of second order at least."""
    from models.catalog import load_scene
    from models.fmu import build_fmu

    scene, times = load_scene("three_cart"), 0.01 * np.arange(201)
    force = np.column_stack([8.0 * np.cos(3.0 * times), -8.0 * np.cos(2.0 * times)])
    starts = dict(zip(("q1", "q2", "q3"), scene.task.start[:3], strict=True))

    def motion(slave: Slave, inputs: tuple[str, str], outputs: Sequence[str]) -> np.ndarray:
        rows = []
        for u in force[:-1]:
            slave.set(**dict(zip(inputs, u, strict=True)))
            slave.step(0.01)
            rows.append(slave.get(*outputs))
        return np.array(rows)

    with unpacked(read_package(build_fmu(scene))) as package:
        own = Slave(package, "CS")
        truth = motion(own.begin(internal_step=1e-4, **starts), ("u1", "u3"), ("q1", "q2", "q3"))
        own.fmu.unload()
    assert (truth[:, 1] - truth[:, 0]).min() < 0.45 < 0.6 < (truth[:, 1] - truth[:, 0]).max()
    errors = {}
    for step in (1e-2, 5e-3, 2.5e-3, 1.25e-3):
        with instance(
            robot(_three_cart()),
            timestep=step,
            **{f"q_{name}": value for name, value in starts.items()},
        ) as fmu:
            errors[step] = np.abs(
                motion(fmu, ("u_1", "u_3"), ("q_q1", "q_q2", "q_q3")) - truth
            ).max()
    # A contact that closes at 1 m/s within a step of h leaves at most k h^2 / 2 m = 15 h^2 m/s
    # wrong, which the damper stops within m / c = 0.5 s.
    assert all(error < 7.5 * step**2 for step, error in errors.items())
    assert errors[1.25e-3] < errors[1e-2] / 10.0


def _in_wheel(path: str) -> Path:
    package, _, inside = path.partition("/")
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        pytest.skip(f"{package} is not installed")
    return Path(spec.origin).parent / inside


@pytest.mark.peer
@pytest.mark.parametrize("path", [
    "dm_control/suite/hopper.xml", "dm_control/suite/quadruped.xml",
    "dm_control/suite/humanoid.xml", "gymnasium/envs/mujoco/assets/ant.xml",
    "gymnasium/envs/mujoco/assets/humanoid.xml",
    "gymnasium_robotics/envs/assets/hand/manipulate_block.xml",
])  # fmt: skip
def test_robots_of_other_wheels_move_to_the_bit(path: str):
    robot = read_robot(_in_wheel(path))
    model, data, rng, touched = robot.model, mujoco.MjData(robot.model), np.random.default_rng(0), 0
    inputs = [variable.name for variable in robot.table if variable.causality == "input"]
    lower, upper = np.where(
        model.actuator_ctrllimited[:, None], model.actuator_ctrlrange, [-1.0, 1.0]
    ).T
    with instance(robot) as fmu:
        for _ in range(1000):
            data.ctrl[:] = 0.7 * rng.uniform(lower, upper)
            mujoco.mj_step(model, data)
            touched += data.ncon > 0
            fmu.set(**dict(zip(inputs, data.ctrl, strict=True)))
            fmu.step(model.opt.timestep)
            assert fmu.get(*states_of(robot)).tolist() == state_of(data).tolist()
    assert touched > 400

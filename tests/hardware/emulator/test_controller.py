"""The controller tick by tick: what its program does with registers, and what stops it."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from resync_robot.core.machines import ARMS
from resync_robot.core.rig import load_rig
from resync_robot.hardware.base import SERVO_PERIOD
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.controller import Controller, ControllerSettings, RobotMode, Runtime, SafetyMode
from resync_robot.hardware.emulator.dashboard import DashboardClient
from resync_robot.hardware.emulator.program import DONE, READY, Command
from resync_robot.hardware.emulator.rtde import RtdeClient, packet
from resync_robot.hardware.emulator.script import ScriptClient

HOME = load_rig().arm.home
SCRIPT = b"def rtde_control():\n  read_input_integer_register(0)\nend\n"


@pytest.fixture
def controller() -> Controller:
    return Controller(KinematicArm(HOME, lag=0.005))


@pytest.fixture
def running(controller: Controller) -> Controller:
    ScriptClient(controller).feed(SCRIPT)
    controller.tick()
    assert controller.program is not None
    return controller


def write(controller: Controller, command: int, *doubles: float, integer: int = 0) -> None:
    values = {f"input_double_register_{i}": v for i, v in enumerate(doubles)}
    controller.on_input({"input_int_register_0": command, "input_int_register_1": integer, **values})


def ticks(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds / SERVO_PERIOD)):
        controller.tick()


def word(controller: Controller) -> int:
    return int(controller.outputs()["output_int_register_0"])


def test_a_script_runs_once_it_is_whole(controller: Controller) -> None:
    client = ScriptClient(controller)
    for i in range(0, len(SCRIPT) - 1, 7):
        client.feed(SCRIPT[i : min(i + 7, len(SCRIPT) - 1)])
    assert controller.runtime is Runtime.STOPPED
    client.feed(SCRIPT[-1:])
    assert controller.runtime is Runtime.PLAYING
    assert controller.uploads == 1


def test_servo_setpoints_are_followed_and_the_word_stays_ready(running: Controller) -> None:
    for k in range(200):
        write(running, Command.SERVOJ, *(HOME + 1e-3 * k))
        running.tick()
        assert word(running) == READY
    ticks(running, 0.1)
    np.testing.assert_allclose(running.measured.q, HOME + 0.199, atol=1e-6)
    np.testing.assert_allclose(running.outputs()["target_q"], HOME + 0.199, atol=1e-12)


def test_other_commands_are_done_once_and_wait_to_be_cleared(running: Controller) -> None:
    write(running, Command.SET_PAYLOAD, 1.5, 0.0, 0.0, 0.05)
    running.tick()
    assert word(running) == DONE and running.payload == 1.5
    write(running, Command.SET_PAYLOAD, 2.5, 0.0, 0.0, 0.05)
    running.tick()
    assert running.payload == 1.5
    write(running, Command.NONE)
    running.tick()
    assert word(running) == READY
    write(running, Command.SET_PAYLOAD, 2.5, 0.0, 0.0, 0.05)
    running.tick()
    assert running.payload == 2.5


@pytest.mark.parametrize("name", ARMS)
def test_it_is_the_arm_of_its_settings(name: str) -> None:
    arm = ARMS[name]
    machine = Controller(KinematicArm(HOME), ControllerSettings(model=arm))
    assert DashboardClient(machine).feed(b"get robot model\n") == f"{arm.polyscope}\n".encode()
    pose = machine.outputs()["actual_TCP_pose"]
    np.testing.assert_allclose(pose[:3], arm.kinematics.forward(HOME)[:3, 3], atol=1e-9)
    for speed, stopped in ((0.999, False), (1.001, True)):
        ScriptClient(machine).feed(SCRIPT)
        machine.tick()
        write(machine, Command.SPEEDJ, *(speed * np.array(arm.speed)), 5.0, 0.1)
        machine.tick()
        assert (machine.safety_mode is SafetyMode.PROTECTIVE_STOP) == stopped


@pytest.mark.parametrize("name", ARMS)
def test_it_carries_no_more_than_its_payload(name: str) -> None:
    most = ARMS[name].payload
    machine = Controller(KinematicArm(HOME), ControllerSettings(model=ARMS[name]))
    ScriptClient(machine).feed(SCRIPT)
    for mass, taken in ((most, most), (most + 0.1, most)):
        write(machine, Command.NONE)
        machine.tick()
        write(machine, Command.SET_PAYLOAD, mass, 0, 0, 0)
        machine.tick()
        assert machine.payload == taken
    assert machine.program is None, "the script ends with an error"


def test_a_move_is_done_when_it_has_arrived(running: Controller) -> None:
    write(running, Command.MOVEJ, *(HOME + 0.1), 1.0, 1.0)
    running.tick()
    assert word(running) == READY
    ticks(running, 0.5)
    assert word(running) == DONE
    np.testing.assert_allclose(running.commanded, HOME + 0.1, atol=1e-9)


def test_speed_goes_on_for_ever_without_a_watchdog_and_not_with_one(running: Controller) -> None:
    write(running, Command.SPEEDJ, 0.1, 0, 0, 0, 0, 0, 1.0, 0.0)
    ticks(running, 3.0)
    assert running.velocity[0] == pytest.approx(0.1)
    write(running, Command.NONE)
    running.tick()
    write(running, Command.SET_WATCHDOG, 10.0)
    running.tick()
    assert word(running) == DONE
    write(running, Command.SPEEDJ, 0.1, 0, 0, 0, 0, 0, 1.0, 0.0)
    ticks(running, 0.09)
    assert running.program is not None
    ticks(running, 0.1)
    assert running.program is None
    ticks(running, 0.1)
    assert np.abs(running.velocity).max() == 0.0


def test_a_protective_stop_unlocks_after_5_s_only_and_runs_nothing(running: Controller) -> None:
    dashboard = DashboardClient(running)
    running.protective_stop()
    assert running.program is None and word_is_absent(running)
    assert running.outputs()["safety_mode"] == 3 and running.outputs()["safety_status_bits"] & 0b100
    ScriptClient(running).feed(SCRIPT)
    assert running.program is None
    ticks(running, 4.9)
    assert b"5s" in dashboard.answer("unlock protective stop")
    assert running.safety_mode is SafetyMode.PROTECTIVE_STOP
    ticks(running, 0.2)
    assert dashboard.answer("unlock protective stop") == b"Protective stop releasing\n"
    assert running.safety_mode is SafetyMode.NORMAL
    assert running.program is None


def word_is_absent(controller: Controller) -> bool:
    return "output_int_register_0" not in controller.outputs()


@pytest.mark.parametrize(
    "mode", [m for m in SafetyMode if m not in (SafetyMode.NORMAL, SafetyMode.REDUCED)], ids=lambda m: m.name
)
def test_every_stop_ends_the_program_and_brakes(running: Controller, mode: SafetyMode) -> None:
    for k in range(100):
        write(running, Command.SERVOJ, *(HOME + 1e-3 * k))
        running.tick()
    running.set_safety(mode)
    assert running.program is None
    ticks(running, 0.2)
    assert np.abs(running.velocity).max() == 0.0
    here = running.commanded.copy()
    write(running, Command.SERVOJ, *HOME)
    ticks(running, 0.1)
    np.testing.assert_array_equal(running.commanded, here)
    assert DashboardClient(running).answer("safetystatus") == f"Safetystatus: {mode.name}\n".encode()


def test_emergency_stops_are_reset_by_no_dashboard(running: Controller) -> None:
    running.set_safety(SafetyMode.ROBOT_EMERGENCY_STOP)
    dashboard = DashboardClient(running)
    for line in ("unlock protective stop", "restart safety", "power on", "brake release", "close safety popup"):
        dashboard.answer(line)
    assert running.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
    assert running.robot_mode is RobotMode.POWER_OFF


@pytest.mark.parametrize("bad", [np.nan, np.inf, 10.0])
def test_a_senseless_setpoint_is_a_protective_stop(running: Controller, bad: float) -> None:
    q = HOME.copy()
    q[3] = bad
    write(running, Command.SERVOJ, *q)
    running.tick()
    assert running.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert np.isfinite(running.commanded).all()


def test_local_control_refuses_scripts_and_orders() -> None:
    controller = Controller(KinematicArm(HOME), ControllerSettings(remote=False))
    ScriptClient(controller).feed(SCRIPT)
    assert controller.program is None and controller.uploads == 0
    dashboard = DashboardClient(controller)
    assert dashboard.answer("is in remote control") == b"false\n"
    assert b"not allowed" in dashboard.answer("power off")
    assert controller.robot_mode is RobotMode.RUNNING


def test_the_slider_and_reduced_mode_scale_speed(running: Controller) -> None:
    running.on_input({"speed_slider_mask": 1, "speed_slider_fraction": 0.4})
    assert running.outputs()["speed_scaling"] == pytest.approx(0.4)
    running.set_safety(SafetyMode.REDUCED)
    assert running.outputs()["speed_scaling"] == pytest.approx(0.2)
    write(running, Command.SPEEDJ, 0.5, 0, 0, 0, 0, 0, 5.0, 0.0)
    ticks(running, 1.0)
    assert running.velocity[0] == pytest.approx(0.1)


def test_forces_are_given_in_the_base_frame() -> None:
    rig = load_rig()
    arm = KinematicArm(HOME)
    controller = Controller(arm, ControllerSettings(world_T_base=rig.arm.world_T_base))
    arm.force[:] = (3.0, 0.0, 10.0)
    controller.tick()
    # The base is turned by half a turn about the world's z.
    np.testing.assert_allclose(controller.outputs()["actual_TCP_force"], (-3.0, 0.0, 10.0, 0, 0, 0), atol=1e-9)
    pose = controller.outputs()["actual_TCP_pose"]
    np.testing.assert_allclose(pose[:3], rig.arm.kinematics.forward(HOME)[:3, 3], atol=1e-9)


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("PolyscopeVersion", "URSoftware 5.22.0.0 (Jan 01 2026)"),
        ("robotmode", "Robotmode: RUNNING"),
        ("running", "Program running: false"),
        ("get robot model", "UR7"),
        ("fly", 'could not understand: "fly"'),
    ],
)
def test_the_dashboard_answers(controller: Controller, line: str, reply: str) -> None:
    assert DashboardClient(controller).feed(line.encode() + b"\n") == reply.encode() + b"\n"


def test_ten_thousand_malformed_lines_harm_nothing(controller: Controller) -> None:
    rng = np.random.default_rng(1)
    words = [b"stop", b"popup ", b"\xff\xfe", b"unlock protective stop", b"\x00", b"load x", b"addToLog "]
    for _ in range(5_000):
        dashboard, script = DashboardClient(controller), ScriptClient(controller)
        line = words[int(rng.integers(len(words)))] + rng.bytes(int(rng.integers(0, 60)))
        assert isinstance(dashboard.feed(line + b"\n"), bytes)
        script.feed(line + b"\nend\n")
    controller.tick()
    assert controller.safety_mode is SafetyMode.NORMAL
    endless = DashboardClient(controller)
    endless.feed(b"x" * 5000)
    assert endless.ended


ODD = (0.0, -1.0, 1.0, 7.0, 1e300, -1e308, float("nan"), float("inf"))


def test_ten_thousand_well_formed_packets_of_any_content_harm_nothing(controller: Controller) -> None:
    """What a client may legally write into the registers: every command, with every kind of number."""
    rng = np.random.default_rng(4)
    client = RtdeClient(controller.settings.version, lambda client, names: True, controller.on_input)
    doubles = ",".join(f"input_double_register_{i}" for i in range(8))
    for names in ("input_int_register_0,input_int_register_1," + doubles, "speed_slider_mask", "speed_slider_fraction"):
        client.feed(packet(ord("I"), names.encode()))
    for k in range(10_000):
        if controller.program is None:
            controller.set_safety(SafetyMode.NORMAL)
            ScriptClient(controller).feed(SCRIPT)
        numbers = rng.choice([*ODD, rng.normal()], 8)
        command = int(rng.choice([*Command, rng.integers(-(2**31), 2**31)]))
        client.feed(packet(ord("U"), b"\x01" + struct.pack(">ii8d", command, k % 2, *numbers)))
        client.feed(packet(ord("U"), b"\x02" + struct.pack(">I", k % 3)))
        client.feed(packet(ord("U"), b"\x03" + struct.pack(">d", rng.choice([*ODD, 0.5]))))
        controller.tick()
        assert np.isfinite(controller.commanded).all() and np.isfinite(controller.velocity).all()
        assert 0.0 <= controller.slider <= 1.0
    assert controller.uploads > 10

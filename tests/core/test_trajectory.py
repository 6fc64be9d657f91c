"""What learning is fed survives a file."""

from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.state import State
from resync_robot.core.symbols import Predicate
from resync_robot.core.trajectory import Trajectory, Transition, read_trajectories, write_trajectories
from resync_robot.core.vocabulary import BLOCK, ROBOT, TYPES

ON = Predicate("On", (BLOCK, BLOCK))
B0, B1, ARM = BLOCK("b0"), BLOCK("b1"), ROBOT("robot")


def random_state(rng: np.random.Generator) -> State:
    return State({o: rng.normal(size=len(o.type.features)) for o in (B0, B1, ARM)}, {B0: np.eye(10) * rng.random()})


@pytest.fixture
def trajectories() -> list[Trajectory]:
    rng = np.random.default_rng(0)
    return [
        Trajectory(
            tuple(
                Transition(random_state(rng), "Pick", (ARM, B1), random_state(rng), bool(rng.integers(2)))
                for _ in range(n)
            ),
            goal=frozenset({ON(B1, B0)}),
            solved=n == 2,
            source=f"before@b{n}",
        )
        for n in (1, 2, 3)
    ]


def test_a_file_gives_back_what_was_written(trajectories: list[Trajectory], tmp_path: Path) -> None:
    path = tmp_path / "trajectories.jsonl"
    write_trajectories(path, trajectories)
    assert list(read_trajectories(path, TYPES, {"On": ON})) == trajectories


def test_a_write_that_fails_leaves_the_old_file(trajectories: list[Trajectory], tmp_path: Path) -> None:
    path = tmp_path / "trajectories.jsonl"
    write_trajectories(path, trajectories)

    def cut_off():
        yield trajectories[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_trajectories(path, cut_off())
    assert list(read_trajectories(path, TYPES, {"On": ON})) == trajectories


def test_the_objects_are_those_of_the_first_state(trajectories: list[Trajectory]) -> None:
    assert trajectories[0].objects == (B0, B1, ARM)
    assert Trajectory((), frozenset(), False, "empty").objects == ()


def test_a_strange_type_is_refused(trajectories: list[Trajectory]) -> None:
    with pytest.raises(UnknownNameError, match="unknown type 'robot'"):
        Trajectory.from_json(trajectories[0].to_json(), {"block": BLOCK}, {"On": ON})

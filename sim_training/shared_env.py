"""One environment of PPO whose scenes are shared out among processes; what it learns is learned in this one."""

from __future__ import annotations

import multiprocessing as mp
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import torch
from torch import Tensor

from resync_robot.core.errors import TrainingError
from resync_robot.core.library import Record
from resync_robot.core.state import State
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.success_model import SuccessModel
from resync_robot.sim_training.ppo import Environment, Rollout
from resync_robot.sim_training.recovery_env import RecoveryEnv, Tried, Try, teach


class SharedEnv(Environment):
    """The scenes of several `RecoveryEnv`, each in a process of its own: an `Environment` of `ppo`.

    A policy rolls in each of them without waiting for the others: where a run of the failed skill judges an episode,
    that takes as long as a hundred actions.

    Args:
        make: (number of the process, its scenes) -> its part; must be picklable, so a function of a module or a partial
            of one.
        model: what all parts follow; it learns from the runs of all of them.
        workers: processes.

    Raises:
        TrainingError: a part cannot be made, or its process ended.
    """

    def __init__(self, make: Callable[[int, int], RecoveryEnv], model: SuccessModel, count: int, workers: int) -> None:
        self.count, self.model = count, model
        self._parts = [part for part in np.array_split(np.arange(count), max(1, workers)) if len(part)]
        context = mp.get_context("forkserver")
        self._connections: list[Connection] = []
        self._processes: list[Any] = []
        for i, part in enumerate(self._parts):
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, make, i, len(part)), daemon=True)
            process.start()
            there.close()
            self._connections.append(here)
            self._processes.append(process)
        try:
            self._observation = np.concatenate(self._answers())
            self._follow()
        except BaseException:
            self.close()
            raise

    def observe(self) -> Tensor:
        """(count, d) relational features."""
        return torch.as_tensor(self._observation, dtype=torch.float32)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """As `RecoveryEnv.step`, of all parts."""
        for connection, part in zip(self._connections, self._parts, strict=True):
            self._send(connection, "step", action[part].numpy())
        columns = [np.concatenate(column) for column in zip(*self._answers(), strict=True)]
        self._observation = columns.pop()
        gained, success, terminated, truncated = (torch.as_tensor(column) for column in columns)
        return gained, success, terminated, truncated

    def reset(self, which: Tensor) -> None:
        """As `RecoveryEnv.reset`; indices count through all parts."""
        wanted = which.numpy()
        asked = [np.flatnonzero(np.isin(part, wanted)) for part in self._parts]
        for connection, inside in zip(self._connections, asked, strict=True):
            self._send(connection, "reset", inside)
        self._observation = np.concatenate(self._answers())

    def roll(self, net: ActorCritic, std: float, steps: int, random: torch.Generator) -> Rollout:
        """As `Environment.roll`, each part with noise of its own."""
        seeds = torch.randint(2**31, (len(self._parts),), generator=random).tolist()
        for connection, seed in zip(self._connections, seeds, strict=True):
            self._send(connection, "roll", (net.shape, net.to_tensors(), std, steps, seed))
        rolled = Rollout.joined([Rollout(*map(torch.from_numpy, part)) for part in self._answers()])
        self._observation = rolled.last.numpy()
        return rolled

    def learn(self) -> Tried:
        """The model learns from the runs of all parts since the last time, and all follow it; these runs."""
        for connection in self._connections:
            self._send(connection, "taken", None)
        runs = [run for part in self._answers() for run in part]
        teach(self.model, runs)
        self._follow()
        return runs

    def attempt(self, count: int) -> None:
        """As `RecoveryEnv.attempt`, shared out among all parts."""
        self._share("attempt", count)
        self._answers()

    def roll_out(self, net: ActorCritic, count: int) -> Tried:
        """As `RecoveryEnv.roll_out`, shared out among all parts."""
        self._share("roll_out", count, net.shape, net.to_tensors())
        return [run for part in self._answers() for run in part]

    def judge_in(self, asked: Sequence[tuple[int, State]]) -> list[Try | None]:
        """As `RecoveryEnv.judge_in`, shared out among all parts."""
        count = len(self._parts)
        for i, connection in enumerate(self._connections):
            self._send(connection, "judge_in", asked[i::count])
        found: list[Try | None] = [None] * len(asked)
        for i, answers in enumerate(self._answers()):
            found[i::count] = answers
        return found

    @property
    def judged(self) -> int:
        """Runs of the failed skill so far."""
        self._share("judged", 0)
        return sum(self._answers())

    def close(self) -> None:
        for connection in self._connections:
            # A signal to all processes may have ended it already.
            with suppress(OSError):
                connection.send(("close", None))
        for process in self._processes:
            process.join(timeout=5)

    def __enter__(self) -> SharedEnv:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _follow(self) -> None:
        if self.model.has_both:
            for connection in self._connections:
                self._send(connection, "follow", self.model.weights())
            self._answers()

    def _share(self, command: str, count: int, *more: Any) -> None:
        shares = np.array_split(np.arange(count), len(self._parts))
        for connection, share in zip(self._connections, shares, strict=True):
            self._send(connection, command, (len(share), *more))

    def _send(self, connection: Connection, command: str, content: Any) -> None:
        try:
            connection.send((command, content))
        except OSError:
            raise TrainingError("a process that steps scenes has ended", "go on with --resume") from None

    def _answers(self) -> Sequence[Any]:
        found = []
        for connection in self._connections:
            try:
                answer = connection.recv()
            except EOFError:
                raise TrainingError("a process that steps scenes has ended", "go on with --resume") from None
            if isinstance(answer, Exception):
                raise answer
            found.append(answer)
        return found


def _serve(connection: Connection, make: Callable[[int, int], RecoveryEnv], number: int, count: int) -> None:
    """Answer the commands of `SharedEnv`, until told to close or left alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    # Whatever goes wrong here is the caller's to know.
    try:
        env = make(number, count)
        connection.send(env.observe().numpy())
        while True:
            command, content = connection.recv()
            if command == "close":
                return
            connection.send(_answer(env, command, content))
    except EOFError:
        return
    except Exception as error:
        with suppress(OSError):
            connection.send(error)


def _answer(env: RecoveryEnv, command: str, content: Any) -> Any:
    if command == "step":
        told = env.step(torch.from_numpy(content))
        return (*(column.numpy() for column in told), env.observe().numpy())
    if command == "reset":
        env.reset(torch.from_numpy(content))
        return env.observe().numpy()
    if command == "roll":
        shape, tensors, std, steps, seed = content
        net = ActorCritic.from_record(Record(shape, tensors))
        rolled = env.roll(net, std, steps, torch.Generator().manual_seed(seed))
        return [getattr(rolled, f.name).numpy() for f in fields(Rollout)]
    if command == "taken":
        return env.taken()
    if command == "attempt":
        return env.attempt(*content)
    if command == "roll_out":
        count, shape, tensors = content
        return env.roll_out(ActorCritic.from_record(Record(shape, tensors)), count)
    if command == "judge_in":
        return env.judge_in(content)
    if command == "judged":
        return env.judged
    env.model.load(content)
    env.follow(env.model)
    return None

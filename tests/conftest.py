"""Settings of every test: one thread, and the same examples on every run."""

import os
import resource
import signal
from collections.abc import Generator, Iterator
from contextlib import contextmanager

import pytest
from hypothesis import settings

from resync_robot.core.errors import MotionError, RenderError
from tests.stalls import MOST_S, LimitBrokenError, Stalls

os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("resync", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("resync")


def pytest_configure() -> None:
    """Tests that were started in the background or by `nohup` ignore signals, and so do programs that they start."""
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_DFL),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """A test marked `realtime` that fails while the machine stood still has shown nothing, and is skipped.

    Not so where a limit was broken: that a setpoint is late excuses no setpoint.
    """
    if item.get_closest_marker("realtime") is None:
        return (yield)
    with Stalls() as stalls:
        try:
            return (yield)
        except Exception as error:
            if stalls.worst > MOST_S and not isinstance(error, MotionError | LimitBrokenError):
                why = f"this machine stood still for {stalls.worst:.2f} s meanwhile; {type(error).__name__}: {error}"
                pytest.skip(why.splitlines()[0])
            raise


@pytest.fixture
def full_disk():
    """`with full_disk(room)`: no file grows beyond so many bytes, as where the disk ends; errno is EFBIG."""

    @contextmanager
    def limited(room: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        # Python ignores the signal that comes with it.
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@pytest.fixture(scope="module")
def renderer() -> None:
    """Skips where this machine cannot draw."""
    # Both take seconds to import, and few tests draw.
    from resync_robot.core.rig import load_rig
    from resync_robot.sim_training.physics.world import SimWorld
    from tests import scenes

    try:
        SimWorld(scenes.scene({"b0": (0.0, 0.0)}), load_rig(), rendered=True)
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")

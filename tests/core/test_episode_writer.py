"""A recording is never written over, and what keeps it from being written is told and never raised."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from tests.core.recorded import meta


def test_missing_file_and_existing_file(tmp_path):
    with pytest.raises(EpisodeError, match="cannot read"):
        read_episode(tmp_path / "none.mcap")
    (tmp_path / "there.mcap").write_bytes(b"x")
    with pytest.raises(EpisodeError, match="exists already"):
        EpisodeWriter(tmp_path / "there.mcap", meta())
    assert (tmp_path / "there.mcap").read_bytes() == b"x"
    with pytest.raises(EpisodeError, match="cannot write"):
        EpisodeWriter(tmp_path / "there.mcap" / "e.mcap", meta())


def test_a_failing_write_is_reported_once_and_never_raised(tmp_path, caplog):
    path = tmp_path / "e.mcap"
    with caplog.at_level(logging.ERROR), EpisodeWriter(path, meta()) as writer:
        writer.tip_force(0.0, np.zeros(3))
        writer.event(0.1, EventKind.SCAN, "first")
        writer.flush()
        os.close(writer._file.fileno())  # the disk goes away
        for k in range(200):
            writer.tip_force(0.2 + k, np.zeros(3))
    assert isinstance(writer.error, EpisodeError)
    assert len(caplog.records) == 1
    episode = read_episode(path)
    assert episode.damage is not None and len(list(episode.tip_force())) >= 1


@pytest.mark.parametrize("room", [0, 3_000])
def test_a_full_disk_keeps_what_can_be_read_and_nothing_else(room, tmp_path):
    path = tmp_path / "e.mcap"
    program = textwrap.dedent(f"""
        import resource, signal
        from pathlib import Path
        import numpy as np
        from resync_robot.core.episode_records import EpisodeMeta
        from resync_robot.core.episode_writer import EpisodeWriter
        from resync_robot.core.errors import DiskError
        from resync_robot.core.rig import load_rig
        meta = EpisodeMeta.of(load_rig(), library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, -1))
        with EpisodeWriter(Path({str(path)!r}), meta) as writer:
            for k in range(2000):
                writer.tip_force(k * 0.02, np.random.normal(size=3))
        assert isinstance(writer.error, DiskError) and "File too large" in writer.error.what, writer.error
    """)
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert path.exists() == (room > 0)
    if room:
        episode = read_episode(path)
        assert episode.damage is not None and episode.meta.backend == "sim"


def test_what_json_cannot_hold_is_reported_and_never_raised(tmp_path, caplog):
    with EpisodeWriter(tmp_path / "e.mcap", meta()) as writer:
        writer.event(0.0, EventKind.SCAN, "odd", thing=object())
    assert writer.error is not None and "not JSON serializable" in writer.error.what
    assert len(caplog.records) == 1


def test_a_killed_process_loses_about_a_second(tmp_path):
    path = tmp_path / "e.mcap"
    program = textwrap.dedent(f"""
        import os, signal, time
        from pathlib import Path
        import numpy as np
        from resync_robot.core.episode_records import EpisodeMeta
        from resync_robot.core.episode_writer import EpisodeWriter
        from resync_robot.core.rig import load_rig
        meta = EpisodeMeta.of(load_rig(), library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")
        writer = EpisodeWriter(Path({str(path)!r}), meta)
        for k in range(500):
            writer.tip_force(k * 0.02, np.zeros(3))
            time.sleep(1e-3)  # what still waits in memory is lost too
        os.kill(os.getpid(), signal.SIGKILL)
    """)
    done = subprocess.run([sys.executable, "-c", program], check=False)
    assert done.returncode == -signal.SIGKILL
    episode = read_episode(path)
    assert episode.damage is not None
    assert len(list(episode.tip_force())) >= 450

"""Where no one looks at a terminal, progress is a line at each tenth."""

from __future__ import annotations

import pytest

from resync_robot.console import Stages, say


def test_a_stage_tells_a_line_for_each_tenth(capsys: pytest.CaptureFixture) -> None:
    with Stages(("mine", "dream")) as bars, bars.stage("mine") as tell:
        for i in range(101):
            tell(i / 100, f"{i} failures")
    shown = capsys.readouterr()
    lines = shown.err.splitlines()
    assert len(lines) == 11
    assert lines[0] == "mine: 0 %  0 failures"
    assert lines[-1] == "mine: 100 %  100 failures"
    assert shown.out == ""


def test_more_than_all_is_all(capsys: pytest.CaptureFixture) -> None:
    with Stages(("mine",)) as bars, bars.stage("mine") as tell:
        tell(1.7, "done")
    assert capsys.readouterr().err == "mine: 100 %  done\n"


def test_a_report_is_said_as_it_is(capsys: pytest.CaptureFixture) -> None:
    line = "[bold]On(b1,b0)[/bold] " + "long " * 60
    say(line)
    assert capsys.readouterr().out == line + "\n"

"""An episode of a domain with a robot of its own as a film: its simulator's pictures, plan, atoms, and the time."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from jaxtyping import UInt8

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import SCENE_VIEW
from resync_robot.core.errors import EpisodeError
from resync_robot.deployment import film_panels as panels
from resync_robot.deployment.film import Frames, decoded


class OwnFilm(Frames):
    """The frames of such an episode.

    Raises:
        EpisodeError: it holds no pictures, or a message makes no sense.
    """

    def __init__(self, episode: Episode) -> None:
        super().__init__(episode, ())
        self._path = episode.path
        self._shown = list(episode.film(SCENE_VIEW))
        if not self._shown:
            raise EpisodeError(
                f"{episode.path} holds no pictures to show",
                "record one with resync-robot deploy, without --record-pictures 0",
            )

    def scene(self, time: float, plain: bool = False) -> UInt8[np.ndarray, "h w 3"]:
        """The latest picture; unless it is to be plain, as large as there is room for, with a label.

        Raises:
            EpisodeError: a plain picture is asked for, and it is damaged.
        """
        at, data = self._shown[max(0, bisect_right(self._shown, time, key=lambda p: p[0]) - 1)]
        picture = decoded(data)
        if not plain:
            return panels.tile(picture, "as simulated" if picture is not None else "a damaged picture", *self._size)
        if picture is None:
            raise EpisodeError(f"{self._path}: the picture at {at:.2f} s is damaged", "give another moment with --at")
        return picture

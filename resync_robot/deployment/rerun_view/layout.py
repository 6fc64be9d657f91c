"""Where everything stands in the viewer's window."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import rerun.blueprint as rrb

from resync_robot.core.episode import Episode
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.symbols import SE2, SE3
from resync_robot.deployment.rerun_view import plane

BACKGROUND = (24, 27, 32)


def blueprint(episode: Episode) -> rrb.Blueprint:
    """The scene left; cameras above and the tabs below on the right."""
    cameras = [
        rrb.Spatial2DView(origin=f"world/cameras/{name}", contents="$origin/colour", name=name)
        for name in episode.cameras
    ]
    tabs = rrb.Tabs(
        rrb.Vertical(
            rrb.TextDocumentView(origin="plan", name="Plan"), rrb.TextLogView(origin="events", name="Events"),
            name="Plan and events",
        ),
        rrb.Horizontal(
            rrb.TextDocumentView(origin="atoms_now", name="Atoms now"),
            rrb.TimeSeriesView(origin="atoms", name="Atoms over time", axis_y=rrb.ScalarAxis(range=(-0.05, 1.05))),
            name="Atoms",
        ),
        *(_arm_tabs() if episode.meta.rig else ()),
        *(_model_tab() if episode.meta.model else ()),
        rrb.TextDocumentView(origin="about", name="About"),
        active_tab=0,
    )  # fmt: skip
    scenes = list(_scenes(episode))
    rows: Iterable[rrb.Container | rrb.View] = [rrb.Horizontal(*cameras), tabs] if cameras else [tabs]
    right = rrb.Vertical(*rows, row_shares=[2, 3] if cameras else [1])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*scenes), right, column_shares=[3, 2]) if scenes else right,
        rrb.TimePanel(timeline="time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _scenes(episode: Episode) -> Iterator[rrb.View]:
    """In space, where there is an arm or anything with a pose in space; in the plane, where anything has one there."""
    poses = [episode.types[kind].pose for kind in episode.meta.objects.values() if kind in episode.types]
    if episode.meta.rig or SE3 in poses:
        # Depth pictures would be drawn as points a second time.
        hidden = [f"- /world/cameras/{name}/depth/**" for name in episode.cameras]
        contents = ["$origin/**", *hidden]
        yield rrb.Spatial3DView(origin="world", contents=contents, name="Scene", background=BACKGROUND)
    if SE2 in poses:
        edges = plane.bounds(episode)
        shown = (
            None if edges is None else rrb.VisualBounds2D(x_range=edges[:, 0].tolist(), y_range=edges[:, 1].tolist())
        )
        yield rrb.Spatial2DView(origin="plane", name="Scene in the plane", background=BACKGROUND, visual_bounds=shown)


def _model_tab() -> Iterator[rrb.Container]:
    yield rrb.Tabs(
        rrb.GraphView(origin="model/graph", name="What makes what true"),
        rrb.TextDocumentView(origin="model/table", name="What each skill needs and does"),
        name="Model",
    )


def _arm_tabs() -> Iterator[rrb.Container]:
    joints = [rrb.TimeSeriesView(origin=f"joints/{j}", name=j.removesuffix("_joint")) for j in ARM_JOINTS]
    yield rrb.Grid(*joints, name="Joints")
    yield rrb.Vertical(
        rrb.TimeSeriesView(origin="gripper", name="Opening, m"),
        rrb.TimeSeriesView(origin="tip_force", name="Force on the hand, N"),
        name="Hand",
    )

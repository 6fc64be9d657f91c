"""The model that was planned with: which skill makes what true for which, as a graph and as a table."""

from __future__ import annotations

import rerun as rr

from resync_robot.core.damage import check_shape
from resync_robot.core.episode import Episode
from resync_robot.core.errors import EpisodeError, PlanningError
from resync_robot.planning.model_graph import Node, graph_of
from resync_robot.planning.model_table import model_table
from resync_robot.planning.pddl import domain_from_pddl

COLOURS = {
    (True, False): (90, 120, 200),
    (True, True): (240, 150, 40),
    (False, False): (120, 125, 135),
    (False, True): (250, 200, 80),
}
"""Of skills and of predicates, not learned and learned: what was given is cold, what was learned is warm."""
LETTER, GAP, LAYER = 7.5, 20.0, 46.0
"""px in the viewer: the width of a letter, the least gap between nodes of a layer, and from layer to layer."""


def draw_model(episode: Episode, recording: rr.RecordingStream) -> None:
    """Log the graph and the table; nothing of recordings that hold no model.

    Raises:
        EpisodeError: what the recording holds is no model.
    """
    if not episode.meta.model:
        return
    try:
        check_shape(episode.meta.model, {"pddl": str, "learned": [str]})
        _, operators = domain_from_pddl(episode.meta.model["pddl"], episode.types)
    except (PlanningError, ValueError) as error:
        raise EpisodeError(f"{episode.path}: /meta holds no model: {error}") from None
    learned = episode.meta.model["learned"]
    table = rr.TextDocument(model_table(operators, learned), media_type=rr.MediaType.MARKDOWN)
    recording.log("model/table", table, static=True)
    graph = graph_of(operators, learned)
    if graph.edges:
        places = graph.places()
        wide = LETTER * max(len(node.name) for node in places) + GAP
        recording.log(
            "model/graph",
            rr.GraphNodes(
                node_ids=[_identity(node) for node in places],
                positions=[(wide * x, LAYER * layer) for x, layer in places.values()],
                labels=[node.name for node in places],
                colors=[COLOURS[node.skill, node.learned] for node in places],
            ),
            rr.GraphEdges(edges=[(_identity(a), _identity(b)) for a, b in graph.edges], graph_type="directed"),
            static=True,
        )


def _identity(node: Node) -> str:
    """A skill may be called as a predicate is."""
    return f"{'skill' if node.skill else 'predicate'}:{node.name}"

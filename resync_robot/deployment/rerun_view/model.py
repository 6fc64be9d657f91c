"""The model that was planned with: which skill makes what true for which, as a graph and as a table."""

from __future__ import annotations

from collections.abc import Mapping

import rerun as rr

from resync_robot.core.damage import check_shape
from resync_robot.core.episode import Episode
from resync_robot.core.errors import EpisodeError, PlanningError
from resync_robot.core.symbols import Operator
from resync_robot.planning.model_table import model_table
from resync_robot.planning.pddl import domain_from_pddl

SKILL, LEARNED_SKILL = (90, 120, 200), (240, 150, 40)
ATOM, LEARNED_ATOM = (120, 125, 135), (250, 200, 80)
"""Colours: what was given is cold, what was learned is warm."""


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
    nodes, edges = graph_of(operators, set(learned))
    if nodes:
        recording.log(
            "model/graph",
            rr.GraphNodes(
                node_ids=list(nodes), labels=[n.partition(":")[2] for n in nodes], colors=list(nodes.values())
            ),
            rr.GraphEdges(edges=edges, graph_type="directed"),
            static=True,
        )


def graph_of(
    operators: tuple[Operator, ...], learned: set[str]
) -> tuple[Mapping[str, tuple[int, int, int]], list[tuple[str, str]]]:
    """Colours of the nodes, and edges from what is needed to the skill, and from the skill to what it makes true.

    A predicate is one node, whoever it is about: the table says about whom.
    """
    nodes: dict[str, tuple[int, int, int]] = {}
    edges: dict[tuple[str, str], None] = {}
    for operator in operators:
        skill = f"skill:{operator.name}"
        nodes[skill] = LEARNED_SKILL if operator.name in learned else SKILL
        for atoms, inwards in ((operator.preconditions, True), (operator.add, False)):
            for name in sorted({a.predicate.name for a in atoms}):
                atom = f"atom:{name}"
                nodes[atom] = LEARNED_ATOM if name in learned else ATOM
                edges[(atom, skill) if inwards else (skill, atom)] = None
    return nodes, list(edges)

"""Avatars whose joints turn, as drafts."""

__all__ = ["avatar_model", "skinned"]

from typing import Any

from contract.adversarial.case import Draft
from contract.adversarial.drafts import declare, generator
from contract.adversarial.dynamic import packed_by_parts, posed, reach, rodrigues, turned_covariance
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Scene, sh_columns


def skinned(graph: GraphBuilder, source: Scene, vectors: str) -> tuple[str, str]:
    """Return positions and covariances, both turned by the rotation vectors of the joints."""
    where, turn = posed(graph, source, rodrigues(graph, vectors))
    return where, turned_covariance(graph, turn, source)


def avatar_model(
    graph: GraphBuilder,
    source: Scene,
    parts: tuple[str, str],
    entries: list[dict[str, Any]],
    *,
    room: float = 0.0,
) -> Draft:
    """Finish an avatar.

    Args:
        graph: The graph so far, inputs included.
        source: The avatar at rest.
        parts: The values that hold positions and covariances.
        entries: Of the manifest's inputs.
        room: How much wider the bounds are than what the joints reach.
    """
    where, upper = parts
    packed = packed_by_parts(graph, where, graph.constant(source.opacity[:, None]), upper)
    manifest = declare(source.count, *reach(source, room), inputs=entries)
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)

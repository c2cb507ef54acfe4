"""The list of all graph rewrites, in the order in which they run.

A comment gives the reason for each block's position. Every pass runs once in a round; rounds are
repeated until nothing changes, so a pass may rely on a later pass of the previous round.
"""

__all__ = ["REWRITES", "find_rewrites"]

from collections.abc import Sequence

from gsgen.contract.errors import UnknownName
from gsgen.sdk.passes.framework.base import Rewrite, RewriteTarget
from gsgen.sdk.passes.indexing.gather_scatters import GatherScatters
from gsgen.sdk.passes.indexing.gather_slices import GatherSlices
from gsgen.sdk.passes.indexing.narrow_hashes import NarrowHashes
from gsgen.sdk.passes.indexing.reduce_scatters import ReduceScatters
from gsgen.sdk.passes.indexing.sample_by_gather import SampleByGather
from gsgen.sdk.passes.lowering.arithmetic_masks import ArithmeticMasks
from gsgen.sdk.passes.lowering.multiply_matrices import MultiplyMatrices
from gsgen.sdk.passes.lowering.pick_parts import LowerSplitsToSlices
from gsgen.sdk.passes.lowering.round_by_floor import LowerRoundToFloor
from gsgen.sdk.passes.lowering.sample_by_product import SampleByProduct
from gsgen.sdk.passes.lowering.select_extremes import SelectExtremes
from gsgen.sdk.passes.lowering.unroll_control_flow import UnrollControlFlow
from gsgen.sdk.passes.lowering.write_out_activations import WriteOutActivations
from gsgen.sdk.passes.lowering.write_out_modulo import WriteOutModulo
from gsgen.sdk.passes.lowering.write_out_norms import WriteOutNorms
from gsgen.sdk.passes.lowering.write_out_reductions import WriteOutReductions
from gsgen.sdk.passes.lowering.write_out_signs import WriteOutSigns
from gsgen.sdk.passes.portability.chunk_concat import ChunkConcat
from gsgen.sdk.passes.portability.chunk_split import ChunkSplit
from gsgen.sdk.passes.portability.clip_before_cast import ClipBeforeCast
from gsgen.sdk.passes.portability.end_outputs_on_compute import EndOutputsOnCompute
from gsgen.sdk.passes.portability.lower_opset import LowerOpset
from gsgen.sdk.passes.portability.narrow_integers import NarrowIntegers
from gsgen.sdk.passes.portability.pad_channels import PadChannels
from gsgen.sdk.passes.portability.restore_guards import RestoreGuards
from gsgen.sdk.passes.portability.split_large_weights import SplitLargeWeights
from gsgen.sdk.passes.rows.mask_rows import MaskRows
from gsgen.sdk.passes.rows.widen_numbers import WidenNumbers
from gsgen.sdk.passes.rows.work_in_columns import RewriteRowsToColumns
from gsgen.sdk.passes.rows.work_in_planes import RewriteRowsToPlanes
from gsgen.sdk.passes.simplify.deduplicate_weights import DeduplicateWeights
from gsgen.sdk.passes.simplify.explicit_defaults import MakeDefaultsExplicit
from gsgen.sdk.passes.simplify.fold_shapes import FoldShapes
from gsgen.sdk.passes.simplify.freeze_dimensions import FreezeDimensions
from gsgen.sdk.passes.simplify.merge_casts import MergeCasts
from gsgen.sdk.passes.simplify.merge_reshapes import MergeReshapes
from gsgen.sdk.passes.simplify.merge_transposes import MergeTransposes
from gsgen.sdk.passes.simplify.remove_no_ops import RemoveNoOps

REWRITES: tuple[type[Rewrite], ...] = (
    # -- First, passes that make shapes and constants known: later passes read them.
    FreezeDimensions,
    FoldShapes,
    UnrollControlFlow,
    # -- Then the guards that an exporter or an optimiser removed.
    RestoreGuards,
    # -- Constructs that no GPU runs, written out with basic operators.
    MaskRows,
    SampleByGather,
    # -- The operator set, before operators are looked up in tables.
    LowerOpset,
    # -- Operators without a kernel, replaced by ones that have one. Integers first: their
    #    replacements may lack a kernel, too.
    MakeDefaultsExplicit,
    ClipBeforeCast,
    NarrowHashes,
    NarrowIntegers,
    ArithmeticMasks,
    GatherScatters,
    ReduceScatters,
    GatherSlices,
    SelectExtremes,
    WriteOutActivations,
    WriteOutModulo,
    WriteOutNorms,
    WriteOutReductions,
    WriteOutSigns,
    MultiplyMatrices,
    LowerRoundToFloor,
    PadChannels,
    # -- Less work: unneeded operators are removed, consecutive ones merged.
    RewriteRowsToColumns,
    SampleByProduct,
    LowerSplitsToSlices,
    MergeTransposes,
    RemoveNoOps,
    MergeCasts,
    MergeReshapes,
    # -- Another layout, after all passes that match rows.
    RewriteRowsToPlanes,
    WidenNumbers,
    DeduplicateWeights,
    # -- Widths and sizes that a target can bind, after every pass that joins tensors.
    SplitLargeWeights,
    ChunkConcat,
    ChunkSplit,
    # -- Last, the operators that produce outputs.
    EndOutputsOnCompute,
)


def find_rewrites(
    target: RewriteTarget, only: Sequence[str] = (), skip: Sequence[str] = ()
) -> list[Rewrite]:
    """Return the graph rewrites that a target runtime needs, in the order in which they run.

    ``only`` and ``skip`` are names of passes; all run without ``only``.
    """
    known = [rewrite.name for rewrite in REWRITES]
    for option, names in (("--pass", only), ("--skip", skip)):
        for name in names:
            if name not in known:
                raise UnknownName.among("pass", name, known, option)
    selected_passes = [
        rewrite
        for rewrite in REWRITES
        if (not only or rewrite.name in only) and rewrite.name not in skip
    ]
    rewrites = [rewrite.for_target(target) for rewrite in selected_passes]
    return [rewrite for rewrite in rewrites if rewrite is not None]

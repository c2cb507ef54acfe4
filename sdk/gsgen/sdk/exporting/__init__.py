"""How does a torch module, a post-process model or a constant scene become a validated ONNX file?

An export runs these steps in this order; the model file is written only if all of them succeed.
Each step passes a frozen record to the next:

1. :mod:`prepare` runs the module in eager torch, at probes (:mod:`eager_reference`), measures its
   bounds, and describes it in a manifest. :mod:`sh_degrees` and :mod:`sh_padding` choose the degree
   of its SH; :mod:`tracing.hazards` records operations that tracing cannot follow.
2. :mod:`tracing` turns the module into an ONNX graph.
3. :mod:`embed_manifest` runs the passes of :mod:`gsgen.sdk.rewriting` for the target, and writes the
   manifest into the graph; :mod:`gsgen.sdk.float16` converts weights and outputs if requested.
4. :mod:`verification` compares the draft with the eager reference, :mod:`parity_diagnosis` explains
   a difference, and :mod:`source_vectors` records rows of the module.
5. :func:`pipeline.check_contract` validates the draft, which is then moved into place.

:mod:`exporter` takes a generator through these steps, :mod:`post_process_exporter` a post-process
model, and :mod:`constant_generator` a scene without inputs, whose graph needs no torch. All three
begin with :class:`pipeline.ExportOptions`, end with :func:`pipeline.check_contract`, and give a
:class:`pipeline.Exported`. :mod:`repair` changes models that exist already.
"""

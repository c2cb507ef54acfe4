"""How does a torch module, a post-process model or a constant scene become a validated ONNX file?

An export runs these steps in this order; the model file is written only if all of them succeed:

1. Eager reference: :mod:`eager_reference` runs the module in eager torch, at probes, and measures
   its bounds. :mod:`sh_degrees` and :mod:`sh_padding` choose the degree of its SH.
2. Hazards: :mod:`trace_hazards` records operations that tracing cannot follow, with the lines of
   the user's code that :mod:`source_lines` finds.
3. Tracing: :mod:`tracing` turns the module into an ONNX graph.
4. Rewriting: :mod:`embed_manifest` runs the passes of :mod:`gsgen.sdk.rewriting` for the target;
   :mod:`gsgen.sdk.float16` converts weights and outputs where float16 is requested.
5. Manifest: :mod:`embed_manifest` writes the manifest into the graph.
6. Verification: :mod:`verification` compares the draft with the eager reference, and
   :mod:`parity_diagnosis` explains a difference.
7. Validation: :func:`pipeline.check_contract` checks the draft against the contract.
8. Atomic write: :func:`pipeline.write_export` moves the draft into place.

:mod:`exporter` takes a generator through steps 1 to 5, :mod:`post_process_exporter` a post-process
model, and :mod:`constant_generator` a scene without inputs, whose graph needs no torch. All three
end with :func:`pipeline.write_export`. :mod:`repair` changes models that exist already.
"""

"""Which readers of checkpoint files do several export plugins share?

Options come from ``cfg_args`` as literals, tensors from ``torch.load(weights_only=True)`` or from
the storages of a TorchScript archive; no code of a file is evaluated, imported or called.

Every reader raises :class:`~gsgen.reference_plugins.loading.errors.CheckpointInvalid` for a file
that is missing or damaged, or contradicts another file.
"""

"""Read what official training code writes, without running any of it.

Options come from ``cfg_args`` as literals, tensors from ``torch.load(weights_only=True)`` or from
the storages of a TorchScript archive; nothing is evaluated, imported or called on a file's behalf.
"""

"""Models that people get wrong, and models that are right: the validator is measured on both.

The models were written from the specification and from the mistakes of people who export
Gaussians, without a look at the rules. ``faults`` and ``later_faults`` hold the wrong ones, a
module for each family of mistakes, and ``right`` the right ones, a module for each tool. To measure
all of them::

    PYTHONPATH=tests python -m contract.adversarial
"""

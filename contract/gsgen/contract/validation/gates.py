"""Rules that others wait for, where more than one family does."""

__all__ = ["RUNNABLE"]

# What must hold before a model is run at all: it can be read and fed, and takes nothing that is
# not its own.
RUNNABLE = (
    *("GM002", "GM003", "GM004"),
    *("GI001", "GI002", "GI003", "GI004", "GI005"),
    *("GG001", "GG002", "GG012", "GG019"),
    *("GS001", "GS002"),
)

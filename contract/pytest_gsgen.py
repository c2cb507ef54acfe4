"""Gives pytest a top-level module to find; the plugin itself is `gsgen.conformance.pytest`.

pytest marks the modules of each installed plugin for assertion rewriting. It finds no package in a
namespace without ``__init__.py``, strips the namespace, and then takes ``gsgen/__main__.py`` for
the running ``__main__``, with a warning that ends runs whose warnings are errors.
"""

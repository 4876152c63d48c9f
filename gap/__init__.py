"""From logs and a model to the cause of their disagreement.

What will live here: `diagnose(model, runs)`, which says where the sim-to-real gap lies, which unmodelled effect causes
it and how far it shrinks once that effect is added; its report and its blind check. Nothing yet.
"""

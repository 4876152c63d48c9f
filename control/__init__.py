"""The control law, its tuning, its robustness study, its export.

What will live here: the passivity-based law and better ones, `tune(law, model, scenario)` by gradient through the
simulated closed loop, the Monte Carlo study, and the export of a law as one file. Nothing yet.
"""

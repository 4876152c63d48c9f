"""An exported law on hardware, without JAX: the loop, drivers, safety and logging of a real rig.

Imports the law, the logs part of ljjax and numpy, and never JAX. Names are found when they are asked for.
"""

"""An exported law on hardware, without JAX.

What will live here: the loop, drivers, safety and logging of a real rig, and `run(law, robot)`. It imports the logs
part of ljjax and numpy, and never JAX. Nothing yet.
"""

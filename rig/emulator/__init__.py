"""A rig that is not there: servos, camera and vacuum that answer the real drivers, around a simulated robot."""

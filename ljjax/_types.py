"""Shapes in one place: n joints, 2 tendons."""

from jaxtyping import Array, Bool, Float

Scalar = Float[Array, ""]
Joints = Float[Array, " n"]
JointMatrix = Float[Array, "n n"]
Tendons = Float[Array, "2"]
Flag = Bool[Array, ""]

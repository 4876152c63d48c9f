"""An effect of one's own: neighbouring segments pull at each other through the outer sleeve.

    ljjax gap runs/ --model model.toml --effects examples/own_effect.py --out out/gap

puts it on trial beside the library's, without a change to the package. Where it is chosen, `model.toml` names this
file, and simulate and fit load it from there.
"""

from __future__ import annotations

import jax

from ljjax.effect import Effect, parameter


class SleeveCoupling(Effect):
    """A spring k (qᵢ − qᵢ₊₁) between neighbours."""

    id, block, axes = "sleeve_coupling", "structure", ("segment", "angle")
    stiffness: jax.Array = parameter("N·m/rad", null=0.0, low=0.0, high=20.0, scale=0.3)

    def load(self, memory, load, now):
        q, out = now.middle, list(load)
        for i in range(len(q) - 1):
            pull = self.stiffness * (q[i] - q[i + 1])
            out[i], out[i + 1] = out[i] - pull, out[i + 1] + pull
        return tuple(out)


if __name__ == "__main__":
    import jax.numpy as jnp

    import ljjax
    from ljjax import modelfile
    from ljjax.data import OCTROBOT

    jax.config.update("jax_enable_x64", True)
    from dataclasses import replace

    bare = modelfile.load(OCTROBOT / "nominal.toml").model
    t = jnp.array([0.0, 0.3, 2.0])
    push = jnp.array([[0.0] * 6, [0.5] + [0.0] * 5, [0.5] + [0.0] * 5])  # N·m, on the first segment alone
    inputs = ljjax.Inputs(t, jnp.zeros((3, 2)), jnp.zeros(3), push, hold=False)
    for name, effects in (("without", ()), ("with", (SleeveCoupling(jnp.asarray(1.0)),))):
        motion = ljjax.simulate(replace(bare, effects=effects), inputs)
        print(f"{name:>8} the sleeve: {jnp.degrees(motion.state.q[-1]).round(2)}°")

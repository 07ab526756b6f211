"""From the shape of a stop to the picture behind it in PyTorch, with gradients; needs the extra ``learn``.

Begin with :mod:`dasim.differentiable.stop`, whose transfer functions :mod:`dasim.differentiable.picture` blurs layers
with. ``examples/learned_ring.py`` learns a stop together with a network.
"""

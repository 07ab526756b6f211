"""Differentiable simulation in PyTorch, from the shape of a stop to the picture; needs the extra ``learn``.

Start with :mod:`dasim.differentiable.stop`, which computes transfer functions; :mod:`dasim.differentiable.picture`
blurs layers with them. ``examples/learned_ring.py`` trains a stop together with a network.
"""

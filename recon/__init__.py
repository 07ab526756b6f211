"""Reconstruction: from a raw picture of a dual-aperture camera to colour, depth and an all-in-focus picture.

>>> import dasim, recon
>>> bank = recon.calibrate(dasim.calibration_captures(camera))
>>> result = recon.reconstruct(shot.capture, bank)

``calibrate`` measures point-spread functions, ``reconstruct`` applies them; ``develop`` makes the colour picture
alone; ``refocus`` focuses the result anew. Values and their files are shared with the simulator, its optics are not.
The public names stand in ``__init__.pyi`` and are loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Reconstruction of colour, depth and an all-in-focus picture from a raw picture of a dual-aperture camera.

>>> import dasim, recon
>>> bank = recon.calibrate(dasim.calibration_captures(camera))
>>> result = recon.reconstruct(shot.capture, bank)

``calibrate`` measures point-spread functions and ``reconstruct`` applies them. ``develop`` computes the colour picture
alone, and ``refocus`` changes the focus of a result. The simulator shares its values and file formats with this
package, but not its optics. Public names are declared in ``__init__.pyi`` and loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

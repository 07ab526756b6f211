"""Physical simulation of dual-aperture cameras.

>>> import dasim
>>> scene = dasim.load_scene("desk")
>>> camera = dasim.focused(dasim.load_camera("da-mobile"), scene)
>>> shot = dasim.simulate(scene, camera, seed=0)

Public names are declared in ``__init__.pyi`` and loaded on first use: ``import dasim`` alone does not load Mitsuba.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""featreg: SAR image features, matching and registration, every method a plugin behind one interface."""

import lazy_loader

from featreg.runtime.showing import drawn_by

# The public names stand in __init__.pyi; each is imported when first asked for, so that `import featreg` is quick.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The types stand below the pictures; only here are both known. The module is imported when something is to be shown.
drawn_by("featreg.pictures.interactive")

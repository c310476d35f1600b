"""featreg: SAR image features, matching and registration, every method a plugin behind one interface."""

import lazy_loader

# The public names stand in __init__.pyi; each is imported when first asked for, so that `import featreg` is quick.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

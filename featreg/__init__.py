"""featreg: SAR image features, matching and registration, every method a plugin behind one interface."""

import lazy_loader

from featreg.runtime.deferred import declare

# The public names stand in __init__.pyi; each is imported when first asked for, so that `import featreg` is quick.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Types and results stand below what draws and warps them; only here are all floors known.
declare(
    html="featreg.pictures.shown:html_of",
    figure="featreg.pictures.shown:figure_of",
    warp="featreg.products.in_memory:warp",
)

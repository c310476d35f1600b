"""Plugins of a package that is not featreg's, as somebody else would write them."""

"""What tests of several packages share."""

from lirs_wct.sources.options import BuildOptions

SMALL = BuildOptions(size=(20.0, 20.0), height=2.0, resize=(129, 129))
"""Options that make of a bundled world one of 20 m and 129 x 129 pixels, which is built at once."""

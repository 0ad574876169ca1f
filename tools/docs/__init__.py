"""Writers of the pages under docs/: they read what was measured and committed, and measure nothing themselves."""

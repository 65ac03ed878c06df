"""Reference models written independently of the package, for comparison tests."""

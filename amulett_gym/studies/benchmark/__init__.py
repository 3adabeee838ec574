"""The benchmark of all contenders on all suites."""

"""The paper as data, and its reproduction: published tables and parameters, and ours beside them."""

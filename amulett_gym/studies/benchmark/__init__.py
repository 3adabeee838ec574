"""The benchmark: every contender on every suite, references, statistics, claims, and the page that shows them."""

"""How fast the kernel could be: the same tick in C, this machine's limits. Yardsticks only; nothing else uses them."""

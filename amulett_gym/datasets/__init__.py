"""Data sets of episodes in the format of Minari: recorded with policies, read by what learns from them."""

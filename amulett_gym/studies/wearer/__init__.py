"""The study of worn devices: baselines, headroom, and learned policies against them."""

"""``python -m amulett_gym`` is ``amulett``."""

from amulett_gym.cli import main

raise SystemExit(main())

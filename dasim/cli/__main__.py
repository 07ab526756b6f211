"""``python -m dasim.cli``."""

from dasim.cli import main

main()

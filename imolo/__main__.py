"""`python -m imolo`."""

from imolo.command_line.start import main

main()

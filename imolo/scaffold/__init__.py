"""`imolo new`: the starting files of a robot or an engine in a distribution of its own."""

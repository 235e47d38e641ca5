"""The valve board: its state machine, its program, and the planner's end of the link; see docs/board-protocol.md."""

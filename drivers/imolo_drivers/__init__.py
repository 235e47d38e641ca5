"""Real wires: the valve board at the other end of a TCP link, motion capture over NatNet, and the emulator of both."""

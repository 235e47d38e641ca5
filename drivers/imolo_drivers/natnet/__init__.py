"""OptiTrack motion capture over NatNet 3.0 to 4.1: client, server for an emulator, playback, calibration."""

"""The flying ball: models of its motion, how they are fitted, and how the ball is followed (paper Sec. V-C)."""

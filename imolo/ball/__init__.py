"""The flying ball: its linear model, how it is fitted, and how the ball is followed (paper Sec. V-C)."""

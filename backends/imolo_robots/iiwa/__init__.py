"""The KUKA LBR iiwa 7 R800, an electric arm of seven joints, from the model that ships with PyBullet."""

"""A pneumatic arm on a stand: two joints, four valves."""

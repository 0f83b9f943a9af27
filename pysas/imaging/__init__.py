"""From echoes to an image: the public doorways, the planner that spends tol, plans, and how they are carried out."""

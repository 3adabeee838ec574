"""What the arm is asked to do, and what pushes it."""

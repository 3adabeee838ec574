"""Section 2.2 of the paper: two PID controllers, the switching agonist and the variable stiffness of eq. 6."""

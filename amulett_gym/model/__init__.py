"""Section 2.1 of the paper: the arm, its springs, its friction, drives and sensors."""

"""The Gymnasium environments: single and vector, over the same kernel."""

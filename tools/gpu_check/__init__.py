"""`make gpu-check`: engines, kernels, policies, planners and speed on a GPU against the CPU."""

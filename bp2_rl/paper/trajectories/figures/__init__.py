"""Pictures of trajectories: the paper's Figs. robot_model_analysis and hardware_opt,
and a family over speed."""

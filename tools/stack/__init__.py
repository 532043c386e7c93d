"""Starting and stopping the stack: the supervisor's configuration of a rig, `up`, `down`."""

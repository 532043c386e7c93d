"""A package, so that its one stack ends with its last test (fixtures of scope `package`)."""

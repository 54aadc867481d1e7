"""Physics in the stream: a process that checks frames which have gone out, and what ties it to the runtime."""

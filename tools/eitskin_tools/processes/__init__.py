"""Child processes: started together, watched together, gone together; their logs and threads."""

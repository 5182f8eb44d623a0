"""The processes of a description: started, watched, stopped."""

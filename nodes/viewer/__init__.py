"""What `tfbus view` is made of: what there is to see, known without any viewer, and the page."""

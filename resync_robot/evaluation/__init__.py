"""What evaluations measure, of whole episodes and of perception alone, as tables and files."""

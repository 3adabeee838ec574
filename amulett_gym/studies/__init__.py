"""What is built with the environments: each study is a folder that nothing else imports."""

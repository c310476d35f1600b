"""What several test files need: images, rasters, scenes, models and results of known truth, one module a subject.

Fixtures stand in the conftest of the folder that asks for them; what is a plain function and serves more than one file
stands here.
"""

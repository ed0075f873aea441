"""Train the reader on simulated radiographs alone. Only this package and `torch` need PyTorch.

training_settings   settings
training_images     images of a data set with landmarks and masks
grey_randomisation  random changes of grey values
random_deformation  random smooth deformations of the bones
landmark_batches    random batches of crops around a knee
locator_batches     random batches of whole images, with and without knees
unet                network
side_network        network that tells right from left knees
losses              losses
training_loop       training with checkpoints
reader_export       networks in ONNX format
reader_thresholds   mean shape, and thresholds from simulations that are wrong on purpose
hold_out            errors on simulated radiographs that were not used for training
reader_maker        all trainings
fine_tuning         training on annotated radiographs
"""

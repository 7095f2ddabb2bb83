"""What cameras see: images, features, taught objects and where they are; knows no bus."""

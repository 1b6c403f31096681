from setuptools import setup

setup(
    name="omad_ros",
    version="0.1.0",
    packages=["omad_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/omad_ros"]),
        ("share/omad_ros", ["package.xml"]),
        ("share/omad_ros/launch", ["launch/omad.launch.py"]),
    ],
    install_requires=["setuptools", "omad"],
    zip_safe=True,
    maintainer="The OMAD developers",
    license="MIT",
    entry_points={"console_scripts": ["omad_node = omad_ros.node:main"]},
)
